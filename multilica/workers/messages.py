# SPDX-License-Identifier: Apache-2.0
"""Messages between the caller and its workers."""

import pickle
import traceback
from collections.abc import Callable, Collection, Sequence
from typing import Any, NamedTuple, NoReturn

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


class Release(NamedTuple):
    """Names of shared values that are no longer needed; None: all."""

    names: Collection[str] | None


class TaskTracebackError(Exception):
    """The cause of an exception that was raised in another process: its traceback there, as text."""


class WorkerFailure(NamedTuple):
    """An exception that travels to another process, with the text of its traceback."""

    error: Exception
    trace: str

    @classmethod
    def of(cls, error: Exception) -> "WorkerFailure":
        """Prepare an exception; one that cannot travel becomes a RuntimeError with its text."""
        trace = "".join(traceback.format_exception(error))
        try:
            pickle.loads(pickle.dumps(error))  # noqa: S301
        except Exception:  # noqa: BLE001
            error = RuntimeError(f"{type(error).__name__}: {error}")
        return cls(error, trace)

    def reraise(self) -> NoReturn:
        """Raise the exception, with its first traceback as the cause."""
        raise self.error from TaskTracebackError(self.trace)
