# SPDX-License-Identifier: Apache-2.0
"""Messages between the caller and its workers."""

from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple

UNREADABLE = -1
"""Number of the job in the answer to a message that a worker could not read."""


class Job(NamedTuple):
    """Tasks for whichever worker is free.

    Args:
        names: under which the results will be shared, if any.
    """

    number: int
    function: Callable[..., object]
    items: Sequence[object]
    names: Sequence[str] = ()


class Answer(NamedTuple):
    """The result of one task, or its failure; with a name, a value that all workers share."""

    job: int
    item: int
    value: Any
    name: str | None = None


class Forgotten(NamedTuple):
    """Names of shared values that are no longer needed; None: all."""

    names: Collection[str] | None
