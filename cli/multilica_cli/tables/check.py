# SPDX-License-Identifier: Apache-2.0
"""Tables of checks against a reference."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from multilica_cli.tables.folding_table import FoldingTable, number_cells

if TYPE_CHECKING:
    from multilica.checks import LidarCheck, RigCheck

_WORDS = {"within": "within", "outside": "OUTSIDE", "undecided": "UNDECIDED"}
_COLUMNS = ("LiDAR", "verdict", "off\nmm", "sigma\nmm", "of\nmm", "off\ndeg", "sigma\ndeg", "of\ndeg")


def print_check(checks: Sequence[RigCheck], written: Sequence[Path], console: Console) -> None:
    """Print a table per rig, the reasons of what is not within, and the outcome."""
    for rig in checks:
        table = FoldingTable(f"{rig.name}, compared to {rig.root}", _COLUMNS, numbers_from=2, keys=2)
        for each in rig.lidars:
            table.add_row(each.lidar, _WORDS[each.verdict], *_cells(each))
        console.print(table)
        for each in rig.lidars:
            if each.verdict != "within":
                console.print(f"{each.lidar}: {each.reason}")
        for note in rig.notes:
            console.print(f"note: {note}")
    for path in written:
        console.print(f"wrote {path}")
    for rig in checks:
        console.print(rig.sentence if len(checks) == 1 else f"{rig.name}: {rig.sentence}")


def _cells(check: LidarCheck) -> tuple[str, ...]:
    lengths = number_cells((check.distance_m, check.sigma_m), 1000.0, 1)
    angles = number_cells((check.angle_deg, check.sigma_deg), 1.0, 3)
    return *lengths, f"{1000.0 * check.max_translation_m:g}", *angles, f"{check.max_rotation_deg:g}"
