# SPDX-License-Identifier: Apache-2.0
"""Tables of the presets on a data set."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from rich.console import Console

from multilica_cli.tables.errors import print_left_out
from multilica_cli.tables.paper import summary_cells, summary_table

if TYPE_CHECKING:
    from multilica.datasets import DatasetRuns, Published
    from multilica.runs import Tolerances
    from multilica.runs.paper_table import PaperSummary, PaperTable


def print_dataset(dataset: str, found: DatasetRuns, known: Published, limits: Tolerances, console: Console) -> None:
    """Print the paper's tables of each preset with what is published, then times and what was left out."""
    tables = {each.preset: table for each in found.presets if (table := each.table(limits)) is not None}
    if known.table is not None:
        tables[known.label] = known.table
    console.print(f"{dataset}: {len(found.scenes)} scene{'s' * (len(found.scenes) != 1)}: {', '.join(found.scenes)}")
    _print_summaries("RMSE over all scenes, to the target", tables, limits, _to_target, console)
    _print_summaries("RMSE over all scenes, between LiDARs", tables, limits, _between, console)
    for each in found.presets:
        if each.stages_s:
            console.print(f"{each.preset}: {each.median_stages_s:.1f} s per scene (median, stages only, one process)")
    for statement in known.statements:
        console.print(f"published: {statement}")
    for scene, preset, reason in found.refused:
        console.print(f"refused: {scene}, preset {preset}: {reason}")
    if found.without_truth:
        console.print(f"without truth, in no table: {', '.join(found.without_truth)}")
    first = next((tables[each.preset] for each in found.presets if each.preset in tables), None)
    if first is not None:
        print_left_out(first.evaluation, console)


def _print_summaries(
    title: str,
    tables: Mapping[str, PaperTable],
    limits: Tolerances,
    rows: Callable[[PaperTable], Mapping[str, PaperSummary]],
    console: Console,
) -> None:
    if not tables:
        return
    printed = summary_table(title, ("preset", "LiDAR"), limits)
    for label, table in tables.items():
        for name, summary in rows(table).items():
            printed.add_row(label, name, *summary_cells(summary))
            label = ""  # noqa: PLW2901 - once per block
        printed.add_section()
    console.print(printed)


def _to_target(table: PaperTable) -> dict[str, PaperSummary]:
    return {**table.by_lidar, "all": table.overall}


def _between(table: PaperTable) -> dict[str, PaperSummary]:
    pairs = {f"{source} in {target}": summary for (target, source), summary in table.by_pair.items()}
    return {**pairs, "all": table.overall_between}
