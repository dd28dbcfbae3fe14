# SPDX-License-Identifier: Apache-2.0
"""Exceptions that travel between processes."""

import pickle
import traceback
from dataclasses import dataclass
from typing import NoReturn


class TaskTracebackError(Exception):
    """The cause of an exception that was raised in another process: its traceback there, as text."""


@dataclass(frozen=True, slots=True)
class TaskFailure:
    """An exception with the text of its traceback."""

    error: Exception
    trace: str

    def reraise(self) -> NoReturn:
        """Raise the exception, with its first traceback as the cause."""
        raise self.error from TaskTracebackError(self.trace)


def failure_of(error: Exception) -> TaskFailure:
    """Prepare an exception for another process; one that cannot travel becomes a RuntimeError with its text."""
    trace = "".join(traceback.format_exception(error))
    try:
        pickle.loads(pickle.dumps(error))  # noqa: S301
    except Exception:  # noqa: BLE001
        return TaskFailure(RuntimeError(f"{type(error).__name__}: {error}"), trace)
    return TaskFailure(error, trace)
