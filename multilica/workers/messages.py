# SPDX-License-Identifier: Apache-2.0
"""Messages between the caller and its workers, in anonymous memory that they share by file descriptor."""

import fcntl
import os
import pickle
import struct
import traceback
from array import array
from collections.abc import Callable, Collection, Iterable, Sequence
from mmap import ACCESS_READ, mmap
from typing import Any, NamedTuple

UNREADABLE = -1
"""Number of the job in the answer to a message that a worker could not read."""

# A buffer starts with a counter and the number of its sections; then come the lengths of the sections, and the
# sections: a pickle, and the arrays that it refers to.
_COUNTER = struct.Struct("=Q")
_LENGTHS_AT = 2 * _COUNTER.size
_ALIGNMENT = 64
_NEVER = 2**63


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


class Shared(dict[str, Any]):
    """Values that all tasks of a pool can use, by name; in a worker process, arrays are read-only."""

    def add(self, name: str, value: object) -> None:
        """Make a value available under a name; raise ValueError if it is taken."""
        self.require_free([name])
        self[name] = value

    def require_free(self, names: Iterable[str]) -> None:
        """Raise ValueError if a value has one of these names."""
        for name in names:
            if name in self:
                raise ValueError(f"'{name}' is shared already")

    def drop(self, names: Collection[str] | None) -> None:
        """Forget the values of those names, or all."""
        for name in tuple(self) if names is None else names:
            del self[name]


def pack(value: object) -> int:
    """Write a value to anonymous memory and return its file descriptor, which the caller closes.

    The memory is freed when no process holds the descriptor or a value that was read from it.
    """
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    sections = [memoryview(head), *(buffer.raw() for buffer in buffers)]
    lengths = array("Q", [section.nbytes for section in sections])
    descriptor = os.memfd_create("multilica")
    with open(descriptor, "wb", closefd=False) as memory:
        memory.write(array("Q", [0, len(sections)]).tobytes() + lengths.tobytes())
        for section in sections:
            memory.seek(_aligned(memory.tell()))
            memory.write(section)
    return descriptor


def unpack(descriptor: int) -> object:
    """Read the value that `pack` wrote; its arrays are read-only views of the shared memory."""
    memory = memoryview(mmap(descriptor, 0, access=ACCESS_READ))
    (count,) = _COUNTER.unpack_from(memory, _COUNTER.size)
    place = _LENGTHS_AT + count * _COUNTER.size
    sections = []
    for length in memory[_LENGTHS_AT:place].cast("Q"):
        place = _aligned(place) + length
        sections.append(memory[place - length : place])
    head, *buffers = sections
    value: object = pickle.loads(head, buffers=buffers)  # noqa: S301 - written by a process of ours
    return value


def _aligned(place: int) -> int:
    """Return the next place that suits the fastest instructions."""
    return -(-place // _ALIGNMENT) * _ALIGNMENT


def claim_next(descriptor: int, *, ends: bool = False) -> int:
    """Return how often this was called for the buffer before, by any process; after `ends`, a number beyond any."""
    # A process that dies releases its lock.
    fcntl.lockf(descriptor, fcntl.LOCK_EX)
    (claimed,) = _COUNTER.unpack(os.pread(descriptor, _COUNTER.size, 0))
    os.pwrite(descriptor, _COUNTER.pack(_NEVER if ends else claimed + 1), 0)
    fcntl.lockf(descriptor, fcntl.LOCK_UN)
    return int(claimed)
