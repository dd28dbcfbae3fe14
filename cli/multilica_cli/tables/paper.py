# SPDX-License-Identifier: Apache-2.0
"""The tables of the paper."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

from rich.console import Console

from multilica_cli.tables.errors import print_left_out, short_names
from multilica_cli.tables.folding_table import FoldingTable

if TYPE_CHECKING:
    from multilica.runs.evaluation import Tolerances
    from multilica.runs.paper_table import AxisError, PairError, PaperSummary, PaperTable

_AXIS_COLUMNS = ("x\nmm", "y\nmm", "z\nmm", "roll\ndeg", "pitch\ndeg", "yaw\ndeg", "angle\ndeg")
_MOST_ROWS = 40


def print_paper_table(table: PaperTable, console: Console) -> None:
    """Print the errors per scene, their RMSE over scenes and LiDARs, and those between LiDARs."""
    console.print(_scene_table(table))
    limits = table.evaluation.tolerances
    pairs = {f"{source} in {target}": summary for (target, source), summary in table.by_pair.items()}
    for title, key, rows, overall in (
        ("RMSE over all scenes, to the target", "LiDAR", table.by_lidar, table.overall),
        ("RMSE over all scenes, between LiDARs", "LiDARs", pairs, table.overall_between),
    ):
        printed = summary_table(title, (key,), limits)
        for name, summary in rows.items():
            printed.add_row(name, *summary_cells(summary))
        if len(rows) > 1:
            printed.add_section()
            printed.add_row("all", *summary_cells(overall))
        console.print(printed)
    print_left_out(table.evaluation, console)


def _axis_error_cells(error: AxisError | None) -> tuple[str, ...]:
    """Format an error for `_AXIS_COLUMNS`."""
    if error is None:
        return ("-",) * len(_AXIS_COLUMNS)
    angles = (*error.rotation_rad, error.angle_rad)
    return *(f"{1e3 * value:z.1f}" for value in error.translation_m), *(f"{degrees(value):z.3f}" for value in angles)


def summary_table(title: str, keys: tuple[str, ...], limits: Tolerances) -> FoldingTable:
    """Create a table whose rows are keys, then `summary_cells`."""
    success = f"success\n{1e3 * limits.within_m:g} mm, {degrees(limits.within_rad):g} deg"
    return FoldingTable(
        title, (*keys, "poses", "placed", success, *_AXIS_COLUMNS), numbers_from=len(keys), keys=len(keys)
    )


def summary_cells(summary: PaperSummary) -> tuple[str, ...]:
    """Format the figures of a row of `summary_table`."""
    counts = (f"{summary.placed} ({summary.placed_rate:.0%})", f"{summary.successes} ({summary.success_rate:.0%})")
    return str(summary.poses), *counts, *_axis_error_cells(summary.rmse)


def _scene_table(table: PaperTable) -> FoldingTable:
    every = table.to_target
    shown = every if len(every) <= _MOST_ROWS else tuple(one for one in every if not one.success)
    title = "Error (found - true) per scene and LiDAR"
    if len(shown) < len(every):
        title += f"; {len(every) - len(shown)} successes are not listed"
    printed = FoldingTable(title, ("run", "LiDAR", "target", "outcome", *_AXIS_COLUMNS), numbers_from=4, keys=2)
    labels = short_names(table.evaluation.runs)
    for one in shown:
        printed.add_row(labels[one.run], one.source, one.target, _outcome(one), *_axis_error_cells(one.error))
    return printed


def _outcome(one: PairError) -> str:
    if one.error is None:
        return "NOT PLACED"
    return "success" if one.success else "FAILURE"
