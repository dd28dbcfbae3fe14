# SPDX-License-Identifier: Apache-2.0
"""What a finished run prints."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console

    from multilica.results import GroundPlane
    from multilica_cli.run import FinishedRun

__all__ = ["print_document", "print_explanation", "print_placements", "print_snapshots", "print_written"]


def print_document(run: FinishedRun) -> None:
    """The document that `result.json` holds, on stdout."""
    sys.stdout.write((run.out_dir / "result.json").read_text(encoding="utf-8"))


def print_placements(run: FinishedRun, console: Console) -> None:
    """The table of the extrinsics."""
    from multilica_cli.tables import placements_table

    result = run.result
    console.print(placements_table(result))
    if any(place.placed and place.lidar != result.target for place in result.placements):
        console.print(f"target {result.target}: {result.target_reason}")
    if result.ground is not None:
        console.print(_ground_line(result.target, result.ground))


def _ground_line(target: str, ground: GroundPlane) -> str:
    roll_deg, pitch_deg, _ = ground.T_base_target.rpy_deg
    height_m = ground.T_base_target.xyz_m[2]
    return f"ground: {height_m:.3f} m below {target}, whose roll is {roll_deg:z.2f} deg and pitch {pitch_deg:z.2f} deg"


def print_explanation(run: FinishedRun, console: Console) -> None:
    """What came of it, in sentences: what is missing and why, what is doubtful, what helps."""
    from multilica.fleet.explain_run import explain_run

    for line in explain_run(run.out_dir).findings:
        console.print(line)


def print_snapshots(run: FinishedRun, console: Console) -> None:
    """A line for each snapshot of a joint result."""
    for snapshot in run.result.snapshots:
        console.print(f"snapshot {snapshot.name}: {snapshot.text}")


def print_written(run: FinishedRun, console: Console) -> None:
    """The paths of what the run left."""
    for path in run.written:
        console.print(f"wrote {path}")
