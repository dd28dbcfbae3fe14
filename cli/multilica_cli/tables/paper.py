# SPDX-License-Identifier: Apache-2.0
"""The tables of the paper, of a set of runs or of the presets on a data set."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.console import Console

from multilica_cli.tables.errors import print_left_out, short_names
from multilica_cli.tables.folding_table import FoldingTable, number_cells

if TYPE_CHECKING:
    from multilica.datasets import DatasetDocument
    from multilica.runs.paper_table import AxisFigures, PaperRow, PaperSummary, PaperTable

_AXIS_COLUMNS = ("x\nmm", "y\nmm", "z\nmm", "roll\ndeg", "pitch\ndeg", "yaw\ndeg", "angle\ndeg")
_AXES = ("x_m", "y_m", "z_m", "roll_deg", "pitch_deg", "yaw_deg", "angle_deg")
_MOST_ROWS = 40
_SUMMARIES: Mapping[str, Callable[[PaperTable], tuple[Sequence[PaperSummary], PaperSummary]]] = {
    "RMSE over all scenes, to the target": lambda table: (table.by_lidar, table.to_target),
    "RMSE over all scenes, between LiDARs": lambda table: (table.by_pair, table.between),
}
"""Title -> the rows of the summary and that over all of them."""


def print_paper_table(table: PaperTable, console: Console) -> None:
    """Print the errors per scene, their RMSE over scenes and LiDARs, and those between LiDARs."""
    console.print(_scene_table(table))
    for (title, rows_of), key in zip(_SUMMARIES.items(), ("LiDAR", "LiDARs"), strict=True):
        rows, overall = rows_of(table)
        printed = _summary_table(title, (key,), table)
        for summary in rows:
            printed.add_row(summary.name, *_summary_cells(summary))
        if len(rows) > 1:
            printed.add_section()
            printed.add_row(overall.name, *_summary_cells(overall))
        console.print(printed)
    print_left_out(table.left_out, console)


def print_dataset(found: DatasetDocument, console: Console) -> None:
    """Print the paper's tables of each preset with what is published, then times and what was left out."""
    known = found.published
    tables = {name: each.table for name, each in found.presets.items() if each.table is not None}
    first = next(iter(tables.values()), None)
    if known.table is not None:
        tables[known.label] = known.table
    scenes = f"{len(found.scenes)} scene{'s' * (len(found.scenes) != 1)}"
    console.print(f"{found.dataset}: {scenes}: {', '.join(found.scenes)}")
    if tables:
        _print_presets(tables, console)
    for name, each in found.presets.items():
        if each.median_stages_s is not None:
            console.print(f"{name}: {each.median_stages_s:.1f} s per scene (median, stages only, one process)")
    for statement in known.statements:
        console.print(f"published: {statement}")
    for one in found.refused:
        console.print(f"refused: {one.scene}, preset {one.preset}: {one.reason}")
    if found.without_truth:
        console.print(f"without truth, in no table: {', '.join(found.without_truth)}")
    if first is not None:
        print_left_out(first.left_out, console)


def _print_presets(tables: Mapping[str, PaperTable], console: Console) -> None:
    for title, rows_of in _SUMMARIES.items():
        printed = _summary_table(title, ("preset", "LiDAR"), next(iter(tables.values())))
        for label, table in tables.items():
            rows, overall = rows_of(table)
            for index, summary in enumerate((*rows, overall)):
                printed.add_row("" if index else label, summary.name, *_summary_cells(summary))
            printed.add_section()
        console.print(printed)


def _axis_error_cells(error: AxisFigures) -> tuple[str, ...]:
    """Format an error for `_AXIS_COLUMNS`."""
    values = tuple(getattr(error, name) for name in _AXES)
    return number_cells(values[:3], 1e3, 1) + number_cells(values[3:], 1.0, 3)


def _summary_table(title: str, keys: tuple[str, ...], limits: PaperTable) -> FoldingTable:
    """Create a table whose rows are keys, then `_summary_cells`."""
    success = f"success\n{1e3 * limits.within_m:g} mm, {limits.within_deg:g} deg"
    return FoldingTable(
        title, (*keys, "poses", "placed", success, *_AXIS_COLUMNS), numbers_from=len(keys), keys=len(keys)
    )


def _summary_cells(summary: PaperSummary) -> tuple[str, ...]:
    """Format the figures of a row of `_summary_table`."""
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
