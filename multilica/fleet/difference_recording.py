# SPDX-License-Identifier: Apache-2.0
"""The rigs of two runs with the clouds that their own recordings hold."""

from __future__ import annotations

from pathlib import Path

from multilica.errors import UnfitSnapshotError
from multilica.extrinsics import Extrinsics
from multilica.fleet.difference import RunDifference, extrinsics_of
from multilica.fleet.run_documents import RunDocument
from multilica.sinks.rerun_reading import read_recorded_cloud
from multilica.sinks.rerun_rigs import LaidRig, write_rigs

__all__ = ["write_difference_recording"]


def write_difference_recording(path: Path, before: RunDocument, after: RunDocument, difference: RunDifference) -> None:
    """Lay both rigs over each other where the first run's target is.

    Raises:
        UnfitSnapshotError: a run has no recording, or they have no LiDAR that both place.
        UnreadableSourceError: a recording is damaged.
        UsageError: the file cannot be written.
    """
    rigs = [_rig(label, run, difference.target) for label, run in (("A", before), ("B", after))]
    write_rigs(path, rigs, _summary(difference))


def _rig(label: str, run: RunDocument, target: str) -> LaidRig:
    if run.recording is None:
        raise UnfitSnapshotError(f"{run.path} has no recording, from which --recording takes the clouds.")
    found = extrinsics_of(run.document)
    if target not in found.T_target_source:
        raise UnfitSnapshotError(
            f"{run.path} does not place {target}, so that the rigs cannot be laid over each other."
        )
    poses = {lidar: found.between(target, lidar) for lidar in found.T_target_source}
    return LaidRig(
        label, Extrinsics(target, poses), {lidar: read_recorded_cloud(run.recording, lidar) for lidar in poses}
    )


def _summary(difference: RunDifference) -> str:
    before, after = difference.names
    rows = [
        f"| {move.lidar} | {1e3 * move.error.distance_m:.1f} | {move.error.angle_deg:.3f} |"
        for move in difference.moves
    ]
    changes = [f"- **{one.lidar}**: {one.before} in A, {one.after} in B. {one.why}" for one in difference.statuses]
    parting = f"They first differ at: **{difference.partings[0].step}**." if difference.partings else "Nothing differs."
    table = "\n".join(["| LiDAR | moved mm | turned deg |", "| --- | --- | --- |", *rows])
    return "\n\n".join(["# Two runs", f"A: `{before}`\n\nB: `{after}`", parting, table, "\n".join(changes)])
