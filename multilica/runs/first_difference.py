# SPDX-License-Identifier: Apache-2.0
"""Steps at which two runs differ."""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from math import isclose
from typing import Any

from pydantic import BaseModel, Field

from multilica.config import STAGES
from multilica.results.document import ResultDocument
from multilica.results.document.values import Entry

# On another CPU equal runs agree to this.
_SAME = 1e-6


class Change(Entry):
    """A value that differs between two runs; None in a run that lacks it."""

    what: str = Field(description="Names of the keys that lead to it, joined by dots.")
    before: Any
    after: Any


@dataclass(frozen=True, slots=True)
class StageDifference:
    """A step at which two runs differ: `input`, `config`, `versions`, or a stage."""

    step: str
    changes: tuple[Change, ...]


def stage_differences(before: ResultDocument, after: ResultDocument) -> tuple[StageDifference, ...]:
    """Return every step at which two runs differ, in order; stages are compared if both have figures of them."""
    return tuple(StageDifference(step, changes) for step, changes in _steps(before, after) if changes)


def _steps(before: ResultDocument, after: ResultDocument) -> Iterator[tuple[str, tuple[Change, ...]]]:
    # The same bytes under another name are the same input.
    unread = {"source"} if before.input.sha256 and before.input.sha256 == after.input.sha256 else set()
    yield "input", _changes(before.input, after.input, unread)
    yield "config", _changes(before.config, after.config)
    yield "versions", tuple(changes_between(before.versions, after.versions))
    figures = [each.stages.model_dump(mode="json") if each.stages else {} for each in (before, after)]
    for stage in STAGES:
        if all(stage in each for each in figures):
            yield stage, tuple(changes_between(figures[0][stage], figures[1][stage]))


def _changes(before: BaseModel, after: BaseModel, exclude: Collection[str] = ()) -> tuple[Change, ...]:
    first, second = (each.model_dump(mode="json", exclude={*exclude}) for each in (before, after))
    return tuple(changes_between(first, second))


def changes_between(before: object, after: object, what: str = "") -> Iterator[Change]:
    """Yield the leaves in which two documents differ, floats by more than 1e-6."""
    if isinstance(before, Mapping) and isinstance(after, Mapping):
        for key in [*before, *(key for key in after if key not in before)]:
            yield from changes_between(before.get(key), after.get(key), f"{what}.{key}" if what else str(key))
    elif not _same(before, after):
        yield Change(what=what, before=before, after=after)


def _same(before: object, after: object) -> bool:
    if isinstance(before, float) and isinstance(after, float):
        return isclose(before, after, rel_tol=_SAME, abs_tol=_SAME)
    if isinstance(before, list) and isinstance(after, list):
        return len(before) == len(after) and all(_same(*pair) for pair in zip(before, after, strict=True))
    return before == after
