# SPDX-License-Identifier: Apache-2.0
"""One of several snapshots of a rig, calibrated alone or refused."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from multilica.results import CalibrationResult, LidarPlacement


@dataclass(frozen=True, slots=True, eq=False)
class SnapshotRun:
    """One snapshot with its own calibration.

    Args:
        name: unique name of the snapshot.
        result: None if the snapshot was refused.
        source, source_sha256: as in `Snapshot`.
        refusal: why it was refused; empty if it was calibrated.
        lidars: names of its LiDARs if it was refused; empty if they are not known.
    """

    name: str
    result: CalibrationResult | None
    source: str = ""
    source_sha256: str = ""
    refusal: str = ""
    lidars: tuple[str, ...] = ()


def only_refused(runs: Sequence[SnapshotRun], known: Collection[str]) -> tuple[LidarPlacement, ...]:
    """Return a placement without a pose for each LiDAR that is only in refused snapshots; `known` are the others."""
    reasons: dict[str, list[str]] = {}
    for run in runs:
        for lidar in run.lidars if run.result is None else ():
            reasons.setdefault(lidar, []).append(f"{run.name}: left out: {run.refusal.rstrip('.')}")
    return tuple(LidarPlacement(lidar, ". ".join(reasons[lidar])) for lidar in sorted(reasons.keys() - {*known}))
