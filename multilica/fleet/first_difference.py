# SPDX-License-Identifier: Apache-2.0
"""Where the ways of two runs part."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import isclose
from typing import Any

from multilica.config import STAGES

__all__ = ["Change", "Parting", "changes_between", "partings_of"]

# With more than one thread equal runs agree to this.
_SAME = 1e-6


@dataclass(frozen=True, slots=True)
class Change:
    """A value that two runs have otherwise.

    Args:
        what: the names that lead to it, joined by dots.
        before, after: of the first and of the second run; None where it has none.
    """

    what: str
    before: Any
    after: Any


@dataclass(frozen=True, slots=True)
class Parting:
    """A step at which two runs differ.

    Args:
        step: `input`, `config`, `versions`, or a stage.
    """

    step: str
    changes: tuple[Change, ...]


def partings_of(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[Parting, ...]:
    """Every step at which two result documents differ, in the order in which a run takes them.

    Stages are compared where both documents have figures of them.
    """
    return tuple(Parting(step, changes) for step, changes in _steps(before, after) if changes)


def _steps(before: Mapping[str, Any], after: Mapping[str, Any]) -> Iterator[tuple[str, tuple[Change, ...]]]:
    yield "input", _changes_of_input(before["input"], after["input"])
    for key in ("config", "versions"):
        yield key, tuple(changes_between(before[key], after[key]))
    figures = before.get("stages", {}), after.get("stages", {})
    for stage in STAGES:
        if all(stage in each for each in figures):
            yield stage, tuple(changes_between(figures[0][stage], figures[1][stage]))


def _changes_of_input(before: Mapping[str, Any], after: Mapping[str, Any]) -> tuple[Change, ...]:
    """The same bytes under another name are the same input."""
    if before["sha256"] and before["sha256"] == after["sha256"]:
        before, after = ({key: value for key, value in each.items() if key != "source"} for each in (before, after))
    return tuple(changes_between(before, after))


def changes_between(before: object, after: object, what: str = "") -> Iterator[Change]:
    """The leaves in which two documents differ, floats by more than 1e-6."""
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for key in [*before, *(key for key in after if key not in before)]:
            yield from changes_between(before.get(key), after.get(key), f"{what}.{key}" if what else str(key))
    elif not _same(before, after):
        yield Change(what, before, after)


def _same(before: object, after: object) -> bool:
    if isinstance(before, float) and isinstance(after, float):
        return isclose(before, after, rel_tol=_SAME, abs_tol=_SAME)
    if isinstance(before, list) and isinstance(after, list):
        return len(before) == len(after) and all(_same(*pair) for pair in zip(before, after, strict=True))
    return before == after
