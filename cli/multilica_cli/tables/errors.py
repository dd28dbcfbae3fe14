# SPDX-License-Identifier: Apache-2.0
"""Tables of pose errors: of runs against ground truth, of a run against another."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import groupby
from os.path import commonpath
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from multilica_cli.tables.folding_table import FoldingTable, number_cells

if TYPE_CHECKING:
    from multilica.runs.difference import Change, Move, RunDifference
    from multilica.runs.evaluation import Comparison, ErrorFigures, Evaluation, LeftOut, Summary

_ERROR_COLUMNS = ("x\nmm", "y\nmm", "z\nmm", "total\nmm", "roll\ndeg", "pitch\ndeg", "yaw\ndeg", "total\ndeg")
_FIGURES = ("x_m", "y_m", "z_m", "distance_m", "roll_deg", "pitch_deg", "yaw_deg", "angle_deg")
_WORDS = {
    "false_accept": "FALSE ACCEPT",
    "false_refuse": "FALSE REFUSE",
    "uncertain_within": "uncertain, within",
    "uncertain_beyond": "UNCERTAIN, BEYOND",
}
_MOST_ROWS = 40
_MOST_CHANGES = 8
_MOST_CHARACTERS = 60


def print_evaluation(evaluation: Evaluation, console: Console) -> None:
    """Print errors per LiDAR, statistics, counts, and what was left out."""
    for table in (_detail_table(evaluation), _statistics_table(evaluation), _outcome_table(evaluation)):
        console.print(table)
    runs = evaluation.runs
    console.print(f"runs with every compared LiDAR within tolerance: {runs.faultless} of {runs.compared}")
    targets = sorted({one.target for one in evaluation.lidars})
    if len(targets) > 1:
        console.print(f"note: the axes are those of each run's own target: {', '.join(targets)}")
    print_left_out(evaluation.left_out, console)


def print_left_out(left_out: Sequence[LeftOut], console: Console) -> None:
    """Print what no count includes, with the reason."""
    for each in left_out:
        what = each.run if each.lidar is None else f"{each.run}, LiDAR {each.lidar}"
        console.print(f"left out: {what}: {each.reason}")


def _error_cells(lengths_m: Sequence[float | None], angles_deg: Sequence[float | None]) -> tuple[str, ...]:
    """Format an error for `_ERROR_COLUMNS`."""
    return number_cells(lengths_m, 1e3, 1) + number_cells(angles_deg, 1.0, 3)


def _figure_cells(figures: ErrorFigures | Comparison, prefix: str = "") -> tuple[str, ...]:
    values = [getattr(figures, f"{prefix}{name}") for name in _FIGURES]
    return _error_cells(values[:4], values[4:])


def _detail_table(evaluation: Evaluation) -> FoldingTable:
    every = evaluation.lidars
    shown = every if len(every) <= _MOST_ROWS else [one for one in every if one.outcome != "within"]
    title = "Error (found - true) in the target's axes"
    if len(shown) < len(every):
        title += f"; {len(every) - len(shown)} LiDARs within tolerance are not listed"
    table = FoldingTable(title, ("run", "LiDAR", "outcome", *_ERROR_COLUMNS, "total\nsigma"), numbers_from=3, keys=2)
    labels = short_names(evaluation.runs.given)
    for run, comparisons in groupby(shown, key=lambda one: one.run):
        label = labels[run]
        for one in comparisons:
            sigma = "-" if one.error_sigma is None else f"{one.error_sigma:.1f}"
            table.add_row(label, one.lidar, _WORDS.get(one.outcome, one.outcome), *_figure_cells(one, "error_"), sigma)
            label = ""
        table.add_section()
    return table


def short_names(runs: tuple[str, ...]) -> dict[str, str]:
    """Return each run without the folder that is common to all."""
    try:
        shared = commonpath([Path(run).parent for run in runs])
    except ValueError:
        return {run: run for run in runs}
    return {run: str(Path(run).relative_to(shared)) for run in runs}


def _statistics_table(evaluation: Evaluation) -> FoldingTable:
    table = FoldingTable("Errors of all placed LiDARs", ("LiDAR", "", *_ERROR_COLUMNS), numbers_from=2, keys=2)
    if evaluation.runs.compared > 1:
        _add_per_lidar(table, evaluation, lambda summary: ("RMSE", *_figure_cells(summary.rmse)))
    overall = evaluation.overall
    table.add_row("all", "RMSE", *_figure_cells(overall.rmse))
    table.add_row("", "median", *_figure_cells(overall.median))
    table.add_row("", "largest", *_figure_cells(overall.largest))
    return table


def _outcome_table(evaluation: Evaluation) -> FoldingTable:
    from multilica.runs.evaluation import UNCERTAIN_SIGMA

    limits = evaluation.tolerances
    within = f"within\n{1e3 * limits.within_m:g} mm, {limits.within_deg:g} deg"
    wrong = f"false accept\n> {1e3 * limits.wrong_m:g} mm, {limits.wrong_deg:g} deg"
    wrong += f" or {limits.wrong_sigma:g} sigma"
    uncertain = tuple(f"uncertain\n{sign} {UNCERTAIN_SIGMA:g} sigma" for sign in ("<=", ">"))
    columns = ("LiDAR", "compared", within, "between", wrong, "false refuse\nnot placed", *uncertain)
    table = FoldingTable("Outcomes", columns)
    _add_per_lidar(table, evaluation, _counts)
    table.add_row("all", *_counts(evaluation.overall))
    return table


def _add_per_lidar(table: FoldingTable, evaluation: Evaluation, cells: Callable[[Summary], tuple[str, ...]]) -> None:
    """Add a row per LiDAR if there are several."""
    if len(evaluation.by_lidar) > 1:
        for lidar, summary in evaluation.by_lidar.items():
            table.add_row(lidar, *cells(summary))
        table.add_section()


def _counts(summary: Summary) -> tuple[str, ...]:
    from multilica.runs.evaluation import OUTCOMES

    counts = [getattr(summary, outcome) for outcome in OUTCOMES]
    return str(summary.lidars), *(f"{count} ({count / summary.lidars:.1%})" for count in counts)


def print_difference(difference: RunDifference, console: Console) -> None:
    """Print which LiDARs moved, which changed status, and at which step the runs first differ."""
    before, after = difference.runs
    console.print(f"A: {before}\nB: {after}")
    if difference.moves:
        console.print(_moves_table(difference))
    for change in difference.statuses.values():
        console.print(f"{change.lidar}: {change.before} in A, {change.after} in B. {change.why}")
    _print_placed_by_neither(difference, console)
    if difference.targets[0] != difference.targets[1]:
        console.print(f"note: the target is {difference.targets[0]} in A and {difference.targets[1]} in B")
    for note in difference.notes:
        console.print(f"note: {note}")
    _print_stage_differences(difference, console)
    console.print(_verdict(difference))


def _print_placed_by_neither(difference: RunDifference, console: Console) -> None:
    """Print LiDARs with the same cause, such as a refused snapshot, in one line."""
    names: dict[tuple[str, str], list[str]] = {}
    for each in difference.placed_by_neither.values():
        names.setdefault((each.before, each.after), []).append(each.lidar)
    for (before, after), lidars in names.items():
        why = before if before == after else f"In A: {before} In B: {after}"
        console.print(f"{', '.join(lidars)}: placed neither in A nor in B. {why}")


def _move_cells(move: Move) -> tuple[str, ...]:
    return _error_cells((*move.translation_m, move.distance_m), (*move.rotation_deg, move.angle_deg))


def _moves_table(difference: RunDifference) -> FoldingTable:
    title = f"Change (B - A) in the axes of {difference.target}"
    table = FoldingTable(title, ("LiDAR", "", *_ERROR_COLUMNS, "sigma"), numbers_from=2, keys=2)
    for lidar, move in difference.moves.items():
        sigma = "-" if move.sigmas is None else f"{move.sigmas:.1f}"
        name = f"{lidar} (uncertain)" if move.uncertain else lidar
        table.add_row(name, "MOVED" if move.moved else "same", *_move_cells(move), sigma)
    return table


def _print_stage_differences(difference: RunDifference, console: Console) -> None:
    if not difference.differences:
        console.print("The runs do not differ at any step.")
        return
    (first, changes), *later = difference.differences.items()
    console.print(f"The runs first differ at: {first}")
    for change in changes[:_MOST_CHANGES]:
        console.print(f"  {change.what}: {_shown(change)}")
    if len(changes) > _MOST_CHANGES:
        console.print(f"  and {len(changes) - _MOST_CHANGES} more, see --json")
    if later:
        console.print(f"after it: {', '.join(step for step, _ in later)}")


def _shown(change: Change) -> str:
    texts = ("none" if value is None else str(value) for value in (change.before, change.after))
    cut = (text if len(text) <= _MOST_CHARACTERS else f"{text[: _MOST_CHARACTERS - 3]}..." for text in texts)
    return " -> ".join(cut)


def _verdict(difference: RunDifference) -> str:
    moved = [lidar for lidar, move in difference.moves.items() if move.moved]
    if difference.same:
        if difference.places_nothing:
            return "Neither run places any LiDAR."
        missing = ", ".join(difference.placed_by_neither)
        return f"Both runs place the same LiDARs at the same places{f'; neither places {missing}' if missing else ''}."
    told = [f"{len(moved)} of {len(difference.moves)} LiDARs moved"] if moved else []
    told += [f"{len(difference.statuses)} changed status"] if difference.statuses else []
    return f"The runs differ: {', '.join(told)}."
