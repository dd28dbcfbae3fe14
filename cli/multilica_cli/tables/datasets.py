# SPDX-License-Identifier: Apache-2.0
"""Tables of the presets on a data set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from rich.console import Console

from multilica_cli.tables.errors import print_left_out
from multilica_cli.tables.paper import summary_cells, summary_table

if TYPE_CHECKING:
    from multilica.datasets import DatasetDocument
    from multilica.runs import Tolerances
    from multilica.runs.paper_table import PaperSummary


def print_dataset(found: DatasetDocument, limits: Tolerances, console: Console) -> None:
    """Print the paper's tables of each preset with what is published, then times and what was left out."""
    known = found.published
    tables = {name: each.table for name, each in found.presets.items() if each.table is not None}
    first = next(iter(tables.values()), None)
    if known.table is not None:
        tables[known.label] = known.table
    scenes = f"{len(found.scenes)} scene{'s' * (len(found.scenes) != 1)}"
    console.print(f"{found.dataset}: {scenes}: {', '.join(found.scenes)}")
    to_target = {label: (*table.by_lidar, table.to_target) for label, table in tables.items()}
    between = {label: (*table.by_pair, table.between) for label, table in tables.items()}
    _print_summaries("RMSE over all scenes, to the target", to_target, limits, console)
    _print_summaries("RMSE over all scenes, between LiDARs", between, limits, console)
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


def _print_summaries(
    title: str, tables: Mapping[str, Sequence[PaperSummary]], limits: Tolerances, console: Console
) -> None:
    if not tables:
        return
    printed = summary_table(title, ("preset", "LiDAR"), limits)
    for label, summaries in tables.items():
        for summary in summaries:
            printed.add_row(label if summary is summaries[0] else "", summary.name, *summary_cells(summary))
        printed.add_section()
    console.print(printed)
