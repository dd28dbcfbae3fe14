# SPDX-License-Identifier: Apache-2.0
"""Tables of a comparison of two runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from multilica_cli.tables.evaluation import ERROR_COLUMNS, error_cells
from multilica_cli.tables.result import plain_table

if TYPE_CHECKING:
    from multilica.runs.difference import RunDifference
    from multilica.runs.first_difference import Change

__all__ = ["print_difference"]

_MOST_CHANGES = 8
_MOST_CHARACTERS = 60


def print_difference(difference: RunDifference, console: Console) -> None:
    """Print which LiDARs moved, which changed status, and at which step the runs first differ."""
    before, after = difference.names
    console.print(f"A: {before}\nB: {after}")
    if difference.moves:
        console.print(_moves_table(difference))
    for change in difference.statuses:
        console.print(f"{change.lidar}: {change.before} in A, {change.after} in B. {change.why}")
    _print_placed_by_neither(difference, console)
    if difference.targets[0] != difference.targets[1]:
        console.print(f"note: the target is {difference.targets[0]} in A and {difference.targets[1]} in B")
    for note in difference.notes:
        console.print(f"note: {note}")
    _print_partings(difference, console)
    console.print(_verdict(difference))


def _print_placed_by_neither(difference: RunDifference, console: Console) -> None:
    """Print LiDARs with the same cause, such as a refused snapshot, in one line."""
    names: dict[tuple[str, str], list[str]] = {}
    for each in difference.neither:
        names.setdefault((each.before, each.after), []).append(each.lidar)
    for (before, after), lidars in names.items():
        why = before if before == after else f"In A: {before} In B: {after}"
        console.print(f"{', '.join(lidars)}: placed neither in A nor in B. {why}")


def _moves_table(difference: RunDifference) -> Table:
    title = f"Change (B - A) in the axes of {difference.target}"
    table = plain_table(title, ("LiDAR", "", *ERROR_COLUMNS, "sigma"), numbers_from=2)
    for move in difference.moves:
        sigma = "-" if move.sigmas is None else f"{move.sigmas:.1f}"
        table.add_row(move.lidar, "MOVED" if move.moved else "same", *error_cells(move.error), sigma)
    return table


def _print_partings(difference: RunDifference, console: Console) -> None:
    if not difference.partings:
        console.print("The runs do not differ at any step.")
        return
    first, *later = difference.partings
    console.print(f"The runs first differ at: {first.step}")
    for change in first.changes[:_MOST_CHANGES]:
        console.print(f"  {change.what}: {_shown(change)}")
    if len(first.changes) > _MOST_CHANGES:
        console.print(f"  and {len(first.changes) - _MOST_CHANGES} more, see --json")
    if later:
        console.print(f"after it: {', '.join(parting.step for parting in later)}")


def _shown(change: Change) -> str:
    texts = ("none" if value is None else str(value) for value in (change.before, change.after))
    cut = (text if len(text) <= _MOST_CHARACTERS else f"{text[: _MOST_CHARACTERS - 3]}..." for text in texts)
    return " -> ".join(cut)


def _verdict(difference: RunDifference) -> str:
    moved = [move.lidar for move in difference.moves if move.moved]
    if difference.same:
        if difference.places_nothing:
            return "Neither run places any LiDAR."
        missing = ", ".join(each.lidar for each in difference.neither)
        return f"Both runs place the same LiDARs at the same places{f'; neither places {missing}' if missing else ''}."
    told = [f"{len(moved)} of {len(difference.moves)} LiDARs moved"] if moved else []
    told += [f"{len(difference.statuses)} changed status"] if difference.statuses else []
    return f"The runs differ: {', '.join(told)}."
