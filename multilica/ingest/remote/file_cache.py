# SPDX-License-Identifier: Apache-2.0
"""The cache of a remote file on disk."""

import mmap
from collections.abc import Callable, Iterable
from pathlib import Path
from threading import Lock

from fsspec.caching import MMapCache
from fsspec.spec import AbstractBufferedFile

BLOCK_BYTES = 256 << 10
"""A request takes about as long as the transfer of this; larger blocks load more around a chunk than they save."""


class FileCache(MMapCache):  # type: ignore[misc]  # fsspec has no types
    """fsspec's cache in a sparse file, for several threads.

    After a failed request, `MMapCache` would return zeros for the missing blocks; here, all blocks are loaded again.

    Args:
        loaded: numbers of the blocks that are on disk already.
    """

    def __init__(self, fetch: Callable[[int, int], bytes], size: int, path: Path, loaded: Iterable[int] = ()) -> None:
        self._lock = Lock()
        super().__init__(BLOCK_BYTES, fetch, size, str(path), set(loaded))

    def read(self, start: int, end: int) -> bytes:
        """Return the bytes from `start` to before `end`; fewer only at the end of the file."""
        with self._lock:
            try:
                return bytes(self._fetch(start, min(end, self.size)))
            except BaseException:
                self.blocks.clear()
                raise

    def _makefile(self) -> mmap.mmap | bytearray:
        # `MMapCache` leaves the file open.
        with Path(self.location).open("ab+") as file:
            file.truncate(self.size)
            return mmap.mmap(file.fileno(), self.size) if self.size else bytearray()


class CachedStream(AbstractBufferedFile):  # type: ignore[misc]  # fsspec has no types
    """A stream over a `FileCache`, which it shares with other streams."""

    def __init__(self, cache: FileCache) -> None:
        super().__init__(None, "", "rb", cache_type="none", size=cache.size)
        self._file_cache = cache

    def _fetch_range(self, start: int, end: int) -> bytes:
        return self._file_cache.read(start, end)
