# SPDX-License-Identifier: Apache-2.0
"""The memory budget of an ingest.

Memory is counted where it is taken: what is unpacked or read as a block until it is released, decoded clouds until the
snapshot is complete.
"""

from __future__ import annotations

import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numpy as np

from multilica.config import IngestConfig
from multilica.errors import InputError

_DECODED_PER_BYTE = 8
"""Text with a few digits per number, or one byte per coordinate; most points shrink when they are decoded."""


class MemoryLimitError(InputError):
    """A source whose reading takes more memory than allowed."""


class MemoryBudget:
    """Bytes that are in use (`taken_bytes`), and their limit.

    Args:
        where: the source, for the error message.
    """

    def __init__(self, limit_mb: float, where: str = "") -> None:
        self._limit_mb = limit_mb
        self._where = where or "The source"
        self.taken_bytes = 0

    def require(self, size: int) -> None:
        """Raise MemoryLimitError if there are not `size` more bytes."""
        taken = self.taken_bytes
        if taken + size > self._limit_mb * 1_000_000:
            raise MemoryLimitError(
                f"Reading {self._where} takes more than {self._limit_mb:g} MB of memory ({taken} bytes in use, {size} "
                "more needed); expected less from LiDARs: take fewer frames, or raise ingest.max_memory_mb."
            )

    def take(self, size: int) -> None:
        """Count `size` more bytes; errors as of `require`."""
        self.require(size)
        self.taken_bytes += size

    def give(self, size: int) -> None:
        """Count `size` fewer bytes."""
        self.taken_bytes -= size

    def empty(self, size: int) -> memoryview:
        """Return memory that is not cleared, counted until it is released; errors as of `require`."""
        self.require(size)
        return self._counted(np.empty(size, np.uint8))

    def keep(self, data: bytes) -> memoryview:
        """Return a view of data, counted until it is released; errors as of `require`."""
        return self._counted(np.frombuffer(data, np.uint8))

    def _counted(self, array: np.ndarray[tuple[int], np.dtype[np.uint8]]) -> memoryview:
        self.take(array.nbytes)
        weakref.finalize(array, self.give, array.nbytes).atexit = False
        return array.data


_CURRENT: ContextVar[MemoryBudget | None] = ContextVar("memory_budget", default=None)


def memory_budget() -> MemoryBudget:
    """Return the budget of the current ingest; outside of one, a new one with the default limit."""
    return _CURRENT.get() or MemoryBudget(IngestConfig().max_memory_mb)


def require_decodable(size: int) -> None:
    """Raise MemoryLimitError if there is no memory for the points that `size` bytes may hold."""
    memory_budget().require(_DECODED_PER_BYTE * size)


@contextmanager
def limited_memory(limit_mb: float, where: str) -> Iterator[MemoryBudget]:
    """Run an ingest with a budget of its own.

    Raises:
        MemoryLimitError: within the block, memory is exhausted.
    """
    budget = MemoryBudget(limit_mb, where)
    token = _CURRENT.set(budget)
    try:
        yield budget
    except MemoryError as error:
        raise MemoryLimitError(
            f"Reading {where} takes more memory than this machine or its limit (ulimit -v) has; take fewer frames."
        ) from error
    finally:
        _CURRENT.reset(token)
