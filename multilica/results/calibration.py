# SPDX-License-Identifier: Apache-2.0
"""The outcome of a calibration."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from multilica.geometry import RigidTransform
from multilica.results.clouds import SensorHealth
from multilica.results.merging import MergeDecision, Refinement
from multilica.results.placements import GroundPlane, LidarPlacement
from multilica.results.registrations import PairRegistration
from multilica.results.snapshots import Refusal, SnapshotReport

__all__ = ["LEVEL_FRAME", "CalibrationResult", "Status"]

LEVEL_FRAME = "level"

Status = Literal["complete", "partial", "failed"]


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationResult:
    """The outcome.

    Args:
        target: root of all poses.
        target_reason: why that LiDAR is the target.
        placements: per LiDAR in name order, the target with the identity.
        pairs: registrations of all pairs that were tried, in name order.
        decisions: the merge steps in order.
        timing_s: wall time per stage.
        refinement: what the joint adjustment did; None where it did not run.
        health: of each LiDAR that was examined, in name order.
        refusal: None unless the snapshot was not fit.
        trusted: the registrations that the poses rest on: accepted pairs, with merges that joined what none of them do.
        snapshots: what each snapshot contributed; empty where there is only one.
        level: pose of the target in a frame with z up, for pictures; None without a ground plane.
    """

    target: str
    target_reason: str
    placements: tuple[LidarPlacement, ...]
    pairs: tuple[PairRegistration, ...] = ()
    decisions: tuple[MergeDecision, ...] = ()
    ground: GroundPlane | None = None
    timing_s: Mapping[str, float] = field(default_factory=dict)
    refinement: Refinement | None = None
    health: tuple[SensorHealth, ...] = ()
    refusal: Refusal | None = None
    trusted: tuple[PairRegistration, ...] = ()
    snapshots: tuple[SnapshotReport, ...] = ()
    level: RigidTransform | None = None

    @property
    def status(self) -> Status:
        """``complete`` if every LiDAR is placed, ``failed`` if none but the target is."""
        placed = sum(placement.placed for placement in self.placements)
        if placed == len(self.placements):
            return "complete"
        return "partial" if placed > 1 else "failed"

    def __getitem__(self, lidar: str) -> LidarPlacement:
        """Return the placement of that LiDAR; KeyError if the rig has none of that name."""
        for placement in self.placements:
            if placement.lidar == lidar:
                return placement
        raise KeyError(lidar)
