# SPDX-License-Identifier: Apache-2.0
"""Output of a finished run."""

from __future__ import annotations

from typing import TYPE_CHECKING

from multilica_cli.failures import ExitCode
from multilica_cli.terminal import stdout_console

if TYPE_CHECKING:
    from multilica.extrinsics import Extrinsics
    from multilica.results import GroundPlane
    from multilica.run import CalibrationRun

__all__ = ["exit_code", "print_run"]


def print_run(run: CalibrationRun, truth: Extrinsics | None = None, *, quiet: bool) -> None:
    """Print the extrinsics, the errors if the truth is known, the files, and why a LiDAR is missing or doubtful."""
    from multilica.runs.explain_run import explain_run
    from multilica_cli.tables.result import placements_table, truth_table

    console, result = stdout_console(quiet=quiet), run.result
    console.print(placements_table(result))
    if any(place.placed and place.lidar != result.target for place in result.placements):
        console.print(f"target {result.target}: {result.target_reason}")
    if result.ground is not None:
        console.print(_ground_line(result.target, result.ground))
    if truth is not None:
        console.print(truth_table(result, truth))
    for snapshot in result.snapshots:
        console.print(f"snapshot {snapshot.name}: {snapshot.text}")
    for path in run.written:
        console.print(f"wrote {path}")
    for line in explain_run(run.directory).findings:
        console.print(line)


def _ground_line(target: str, ground: GroundPlane) -> str:
    roll_deg, pitch_deg, _ = ground.T_base_target.rpy_deg
    height_m = ground.T_base_target.xyz_m[2]
    return f"ground: {target} is {height_m:.3f} m above it, roll {roll_deg:z.2f} deg, pitch {pitch_deg:z.2f} deg"


def exit_code(run: CalibrationRun) -> ExitCode:
    """Return DONE if every LiDAR is placed, or if the run was to stop before it places any."""
    from multilica.config import STAGES

    stopped_early = STAGES.index(run.config.until) < STAGES.index("merge")
    return ExitCode.DONE if stopped_early or run.result.status == "complete" else ExitCode.NOT_PLACED
