# SPDX-License-Identifier: Apache-2.0
"""The tables of the paper."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console

from multilica_cli.tables.errors import number_cells, print_left_out, short_names
from multilica_cli.tables.folding_table import FoldingTable

if TYPE_CHECKING:
    from multilica.runs.evaluation import Tolerances
    from multilica.runs.paper_table import AxisFigures, PaperRow, PaperSummary, PaperTable

_AXIS_COLUMNS = ("x\nmm", "y\nmm", "z\nmm", "roll\ndeg", "pitch\ndeg", "yaw\ndeg", "angle\ndeg")
_AXES = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg", "angle_deg")
_MOST_ROWS = 40


def print_paper_table(table: PaperTable, console: Console) -> None:
    """Print the errors per scene, their RMSE over scenes and LiDARs, and those between LiDARs."""
    console.print(_scene_table(table))
    for title, key, rows, overall in (
        ("RMSE over all scenes, to the target", "LiDAR", table.by_lidar, table.to_target),
        ("RMSE over all scenes, between LiDARs", "LiDARs", table.by_pair, table.between),
    ):
        printed = summary_table(title, (key,), table)
        for summary in rows:
            printed.add_row(summary.name, *summary_cells(summary))
        if len(rows) > 1:
            printed.add_section()
            printed.add_row(overall.name, *summary_cells(overall))
        console.print(printed)
    print_left_out(table.left_out, console)


def _axis_error_cells(error: AxisFigures) -> tuple[str, ...]:
    """Format an error for `_AXIS_COLUMNS`."""
    values = tuple(getattr(error, name) for name in _AXES)
    return number_cells(values[:3], 1e3, 1) + number_cells(values[3:], 1.0, 3)


def summary_table(title: str, keys: tuple[str, ...], limits: Tolerances | PaperTable) -> FoldingTable:
    """Create a table whose rows are keys, then `summary_cells`."""
    success = f"success\n{1e3 * limits.within_m:g} mm, {limits.within_deg:g} deg"
    return FoldingTable(
        title, (*keys, "poses", "placed", success, *_AXIS_COLUMNS), numbers_from=len(keys), keys=len(keys)
    )


def summary_cells(summary: PaperSummary) -> tuple[str, ...]:
    """Format the figures of a row of `summary_table`."""
    counts = (f"{summary.placed} ({summary.placed_rate:.0%})", f"{summary.successes} ({summary.success_rate:.0%})")
    return str(summary.poses), *counts, *_axis_error_cells(summary.rmse)


def _scene_table(table: PaperTable) -> FoldingTable:
    every = table.rows
    shown = every if len(every) <= _MOST_ROWS else tuple(one for one in every if not one.success)
    title = "Error (found - true) per scene and LiDAR"
    if len(shown) < len(every):
        title += f"; {len(every) - len(shown)} successes are not listed"
    printed = FoldingTable(title, ("run", "LiDAR", "target", "outcome", *_AXIS_COLUMNS), numbers_from=4, keys=2)
    labels = short_names(tuple({one.run for one in every} | {one.run for one in table.left_out}))
    for one in shown:
        printed.add_row(labels[one.run], one.source, one.target, _outcome(one), *_axis_error_cells(one))
    return printed


def _outcome(one: PaperRow) -> str:
    if one.error is None:
        return "NOT PLACED"
    return "success" if one.success else "FAILURE"
