# SPDX-License-Identifier: Apache-2.0
"""A remote file in blocks that are fetched once."""

from __future__ import annotations

import io
from collections import OrderedDict
from collections.abc import Callable
from itertools import groupby
from threading import Lock

__all__ = ["BLOCK_BYTES", "BlockCache", "BlockStream"]

BLOCK_BYTES = 256 << 10
"""A request costs about as long as this takes to arrive; larger blocks fetch more around a chunk than they save."""
_MAX_BLOCKS = 128


class BlockCache:
    """Bytes by range; neighbouring blocks that are missing come with one request.

    Args:
        fetch: gives the bytes from one offset to another.
        size: length of the file in bytes.
    """

    def __init__(self, fetch: Callable[[int, int], bytes], size: int) -> None:
        self.size = size
        self._fetch = fetch
        self._blocks: OrderedDict[int, bytes] = OrderedDict()
        self._lock = Lock()

    def read(self, start: int, end: int) -> bytes:
        """The bytes from `start` to before `end`, both within the file."""
        if end <= start:
            return b""
        first = start // BLOCK_BYTES
        with self._lock:
            joined = b"".join(self._blocks_of(range(first, (end - 1) // BLOCK_BYTES + 1)))
        return joined[start - first * BLOCK_BYTES : end - first * BLOCK_BYTES]

    def _blocks_of(self, indices: range) -> list[bytes]:
        found = {index: self._blocks[index] for index in indices if index in self._blocks}
        known = frozenset(found)
        for is_known, run in groupby(indices, key=known.__contains__):
            if not is_known:
                found |= self._fetched(list(run))
        for index in indices[-_MAX_BLOCKS:]:
            self._blocks[index] = found[index]
            self._blocks.move_to_end(index)
        while len(self._blocks) > _MAX_BLOCKS:
            self._blocks.popitem(last=False)
        return [found[index] for index in indices]

    def _fetched(self, run: list[int]) -> dict[int, bytes]:
        start = run[0] * BLOCK_BYTES
        data = memoryview(self._fetch(start, min((run[-1] + 1) * BLOCK_BYTES, self.size)))
        return {
            index: bytes(data[offset : offset + BLOCK_BYTES])
            for index, offset in zip(run, range(0, len(data), BLOCK_BYTES), strict=True)
        }


class BlockStream(io.RawIOBase):
    """A position in a `BlockCache`."""

    def __init__(self, cache: BlockCache) -> None:
        self._cache = cache
        self._position = 0

    def read(self, size: int = -1, /) -> bytes:
        """As of any stream: fewer bytes only at the end."""
        end = self._cache.size if size < 0 else min(self._position + size, self._cache.size)
        data = self._cache.read(self._position, end)
        self._position += len(data)
        return data

    def readinto(self, buffer: memoryview, /) -> int:  # type: ignore[override]  # all that is ever given
        """As of any stream: fewer bytes only at the end."""
        data = self.read(len(buffer))
        buffer[: len(data)] = data
        return len(data)

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        """As of any stream."""
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._cache.size}[whence]
        if base + offset < 0:
            raise OSError(f"there is nothing at {base + offset} bytes")
        self._position = base + offset
        return self._position

    def tell(self) -> int:
        """As of any stream."""
        return self._position

    def readable(self) -> bool:
        """Always."""
        return True

    def seekable(self) -> bool:
        """Always."""
        return True
