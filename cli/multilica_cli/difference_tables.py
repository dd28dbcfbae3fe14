# SPDX-License-Identifier: Apache-2.0
"""A difference of runs as tables for people."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

from multilica_cli.tables import plain_table

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from multilica.fleet.difference import Move, RunDifference
    from multilica.fleet.first_difference import Change

__all__ = ["print_difference"]

_COLUMNS = ("x\nmm", "y\nmm", "z\nmm", "moved\nmm", "roll\ndeg", "pitch\ndeg", "yaw\ndeg", "turned\ndeg", "sigma")
_MOST_CHANGES = 8
_MOST_CHARACTERS = 60


def print_difference(difference: RunDifference, console: Console) -> None:
    """What moved, what changed status, and where the runs part."""
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
    """Those of one cause, such as a refused snapshot, in one line."""
    names: dict[tuple[str, str], list[str]] = {}
    for each in difference.neither:
        names.setdefault((each.before, each.after), []).append(each.lidar)
    for (before, after), lidars in names.items():
        why = before if before == after else f"In A: {before} In B: {after}"
        console.print(f"{', '.join(lidars)}: placed neither in A nor in B. {why}")


def _moves_table(difference: RunDifference) -> Table:
    title = f"B less A, in the axes of {difference.target}"
    table = plain_table(title, ("LiDAR", "", *_COLUMNS), numbers_from=2)
    for move in difference.moves:
        table.add_row(move.lidar, "MOVED" if move.moved else "same", *_figures(move))
    return table


def _figures(move: Move) -> tuple[str, ...]:
    error = move.error
    millimetres = (f"{1e3 * value:z.1f}" for value in (*error.translation_m, error.distance_m))
    angles = (f"{degrees(value):z.3f}" for value in (*error.rotation_rad, error.angle_rad))
    return (*millimetres, *angles, "-" if move.sigmas is None else f"{move.sigmas:.1f}")


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
    return " -> ".join(_cut("none" if value is None else str(value)) for value in (change.before, change.after))


def _cut(text: str) -> str:
    return text if len(text) <= _MOST_CHARACTERS else f"{text[: _MOST_CHARACTERS - 3]}..."


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
