# SPDX-License-Identifier: Apache-2.0
"""What became of each snapshot."""

from dataclasses import dataclass

__all__ = ["Refusal", "SnapshotDeviation", "SnapshotReport"]


@dataclass(frozen=True, slots=True)
class Refusal:
    """Why a snapshot was not calibrated at all.

    Args:
        code: stable name, for programs: `moving_vehicle`, `too_few_lidars`, `blind_target`.
        text: the sentence of the error that `calibrate` raises.
    """

    code: str
    text: str


@dataclass(frozen=True, slots=True)
class SnapshotDeviation:
    """How far one snapshot by itself places a LiDAR from where the joint result has it.

    Args:
        outlier: whether the snapshot was outvoted on this LiDAR.
    """

    lidar: str
    distance_m: float
    angle_deg: float
    outlier: bool = False

    @property
    def text(self) -> str:
        """How far, for people."""
        return f"{1000.0 * self.distance_m:.1f} mm, {self.angle_deg:.3f} deg"


@dataclass(frozen=True, slots=True)
class SnapshotReport:
    """What one snapshot contributed to a joint result.

    Args:
        deviations: of the LiDARs that it places, in name order.
        disputed: LiDARs on which it contradicts other snapshots without a majority.
        refusal: why the whole snapshot was left out; empty if it was not.
    """

    name: str
    source: str
    source_sha256: str
    deviations: tuple[SnapshotDeviation, ...] = ()
    disputed: tuple[str, ...] = ()
    refusal: str = ""

    @property
    def outliers(self) -> tuple[SnapshotDeviation, ...]:
        """The LiDARs on which the other snapshots outvoted this one."""
        return tuple(deviation for deviation in self.deviations if deviation.outlier)

    @property
    def text(self) -> str:
        """What became of it, for people."""
        if self.refusal:
            return f"left out: {self.refusal}"
        parts = [
            f"OUTLIER: {each.lidar} is off by {each.text} where the other snapshots agree" for each in self.outliers
        ]
        parts += [f"contradicts other snapshots on {lidar}, without a majority" for lidar in self.disputed]
        if parts:
            return "; ".join(parts)
        if not self.deviations:
            return "places no LiDAR relative to the target"
        largest = max(self.deviations, key=lambda deviation: deviation.distance_m)
        return f"agrees: {largest.lidar} is off most, by {largest.text}"
