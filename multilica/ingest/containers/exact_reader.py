# SPDX-License-Identifier: Apache-2.0
"""A file whose reads are complete or fail."""

from io import BufferedReader, RawIOBase
from struct import Struct
from typing import Any, cast

import numpy as np

from multilica.ingest.remote.remote_file import SourceFile

__all__ = ["EndOfFileError", "ExactReader", "unpack_head"]


class EndOfFileError(EOFError):
    """The file has fewer bytes than requested."""


class ExactReader(BufferedReader):
    """An open file whose reads return all requested bytes or fail.

    Libraries take a short read for a whole record, and allocate whatever size a corrupt length claims.
    """

    def __init__(self, path: SourceFile) -> None:
        super().__init__(cast(RawIOBase, path.open("rb", buffering=0)))
        self._size = path.stat().st_size

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

    def view(self, size: int) -> memoryview:
        """Read like `read`, into memory that is not cleared first, which is faster."""
        if size > self.remaining:
            raise EndOfFileError
        data = np.empty(size, np.uint8).data
        if self.readinto(data) != size:
            raise EndOfFileError
        return data


def unpack_head(layout: Struct, data: bytes | memoryview, place: int = 0) -> tuple[Any, ...]:
    """Return the values at a place; raise EndOfFileError if the data end before."""
    if place + layout.size > len(data):
        raise EndOfFileError
    return layout.unpack_from(data, place)
