# SPDX-License-Identifier: Apache-2.0
"""A file whose reads are complete or fail."""

import errno
import os
from contextlib import suppress
from io import BufferedReader, RawIOBase
from struct import Struct
from typing import Any, cast

from multilica.ingest.memory import memory_budget
from multilica.ingest.remote.remote_file import SourceFile

_ZEROS = bytes(4 << 20)
_MAX_SKIPPED = 1000
"""Regions of zeros; a power loss leaves a few."""


class EndOfFileError(EOFError):
    """The file has fewer bytes than requested."""


class ExactReader(BufferedReader):
    """An open file whose reads return all requested bytes or fail.

    Libraries take a short read for a whole record, and allocate whatever size a corrupt length claims.
    """

    def __init__(self, path: SourceFile) -> None:
        super().__init__(cast(RawIOBase, path.open("rb", buffering=0)))
        self._size = path.stat().st_size
        self._skipped = 0

    @property
    def remaining(self) -> int:
        """Number of bytes behind the current position."""
        return self._size - self.tell()

    def read(self, size: int | None = None, /) -> bytes:
        """Read exactly `size` bytes, all that remain if None; raise EndOfFileError if there are fewer."""
        size = self.remaining if size is None else size
        if size > self.remaining:
            raise EndOfFileError
        return super().read(size)

    def skip_zeros(self, start: int) -> None:
        """Move from `start` to the next byte that is not zero, as a power loss leaves them where no block was written.

        Holes of a sparse file are not read.

        Raises:
            ValueError: nothing but zeros follows, or it was called more often than any damage explains.
        """
        self._skipped += 1
        if self._skipped > _MAX_SKIPPED:
            raise ValueError("its records make no sense")
        self.seek(start)
        size = 4 << 10
        while self.remaining:
            block = super().read(min(size, self.remaining))
            if block != _ZEROS[: len(block)]:
                self.seek(self.tell() - len(block.lstrip(b"\0")))
                return
            size = len(_ZEROS)
            self._skip_hole()
        raise ValueError("the file ends in zeros, as after a power loss")

    def _skip_hole(self) -> None:
        place = self.tell()
        with suppress(OSError, ValueError):
            descriptor = self.fileno()
            before = os.lseek(descriptor, 0, os.SEEK_CUR)
            try:
                place = os.lseek(descriptor, place, os.SEEK_DATA)
            except OSError as error:
                place = self._size if error.errno == errno.ENXIO else place
            finally:
                os.lseek(descriptor, before, os.SEEK_SET)
        self.seek(place)

    def view(self, size: int) -> memoryview:
        """Read like `read`, into memory that is not cleared first, which is faster."""
        if size > self.remaining:
            raise EndOfFileError
        data = memory_budget().empty(size)
        if self.readinto(data) != size:
            raise EndOfFileError
        return data


def unpack_head(layout: Struct, data: bytes | memoryview, place: int = 0) -> tuple[Any, ...]:
    """Return the values at a place; raise EndOfFileError if the data end before."""
    if place + layout.size > len(data):
        raise EndOfFileError
    return layout.unpack_from(data, place)
