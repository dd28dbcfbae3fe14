# SPDX-License-Identifier: Apache-2.0
"""Memory that is filled again once nobody looks at what it held."""

from __future__ import annotations

import mmap
import sys
from collections.abc import Sequence
from contextlib import suppress
from threading import Lock

import numpy as np
import numpy.typing as npt

__all__ = ["ReusedMemory"]

_MOST_KEPT = 3
"""One that is read, one that is unpacked ahead, one that is used."""
_MOST_KEPT_BYTES = 32 << 20
_HUGE_PAGE_BYTES = 2 << 20


class ReusedMemory:
    """Gives memory for one chunk after the other: fresh memory costs the system more than it costs to fill it."""

    def __init__(self) -> None:
        self._kept: list[npt.NDArray[np.uint8]] = []
        self._lock = Lock()

    def of_size(self, size: int) -> memoryview:
        """So many bytes of any content, nobody else's as long as a view of them, or of a part, is held."""
        with self._lock:
            for index, length in enumerate(map(len, self._kept)):
                # A small chunk in a large buffer, held for long, would hold all of it.
                if size <= length <= 2 * size and _references(self._kept, index) == _REFERENCES_IF_UNUSED:
                    return self._kept[index].data[:size]
            if size > _MOST_KEPT_BYTES:
                return np.empty(size, np.uint8).data
            fresh = _fresh(size)
            self._kept = [*self._kept[1 - _MOST_KEPT :], fresh]
            return fresh.data[:size]


def _fresh(size: int) -> npt.NDArray[np.uint8]:
    """So many bytes, or somewhat more: in huge pages where there are any, for the system takes its time by the page."""
    if size >= _HUGE_PAGE_BYTES and hasattr(mmap, "MADV_HUGEPAGE"):
        whole_pages = -(-size // _HUGE_PAGE_BYTES) * _HUGE_PAGE_BYTES
        with suppress(OSError):  # a kernel without them
            pages = mmap.mmap(-1, whole_pages, mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS)
            pages.madvise(mmap.MADV_HUGEPAGE)
            return np.frombuffer(pages, np.uint8)
    return np.empty(size, np.uint8)


def _references(arrays: Sequence[object], index: int) -> int:
    # Views, and views of views, hold the array that owns the memory; a weak reference to a view in between may die
    # before them, because NumPy leaves out what is in between.
    return sys.getrefcount(arrays[index])


_REFERENCES_IF_UNUSED = _references([object()], 0)
