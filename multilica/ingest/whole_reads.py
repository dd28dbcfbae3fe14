# SPDX-License-Identifier: Apache-2.0
"""A file that never gives fewer bytes than were asked for."""

from __future__ import annotations

from io import SEEK_SET, BufferedReader, BytesIO
from typing import IO, Self, cast

from multilica.ingest.remote_file import SourceFile
from multilica.ingest.reused_memory import ReusedMemory

__all__ = ["EndOfFileError", "WholeReads"]


class EndOfFileError(EOFError):
    """The file holds fewer bytes than were asked for."""


class WholeReads:
    """A stream whose reads give all bytes that are asked for, or say that it ends.

    Libraries take a short read for a whole record, and set memory aside for whatever a damaged length claims.

    Args:
        stream: a seekable stream; closed together with this one.
        size: its length in bytes.
    """

    def __init__(self, stream: IO[bytes], size: int) -> None:
        self._stream = stream
        self._size = size
        self._memory = ReusedMemory()

    @classmethod
    def of_file(cls, path: SourceFile) -> Self:
        """The bytes of a file."""
        return cls(path.open("rb"), path.stat().st_size)

    @classmethod
    def of_bytes(cls, data: bytes) -> Self:
        """Bytes in memory."""
        return cls(BytesIO(data), len(data))

    @property
    def remaining(self) -> int:
        """Bytes that were not read yet."""
        return self._size - self._stream.tell()

    def read(self, size: int) -> bytes:
        """Exactly `size` bytes.

        Raises:
            EndOfFileError: there are fewer.
        """
        if size > self.remaining:
            raise EndOfFileError
        return self._stream.read(size)

    def view(self, size: int) -> memoryview:
        """As `read`, into memory that is used again once no view of it is held.

        Raises:
            EndOfFileError: there are fewer.
        """
        if size > self.remaining:
            raise EndOfFileError
        data = self._memory.of_size(size)
        # `IO` leaves out what every binary stream has.
        if cast(BufferedReader, self._stream).readinto(data) != size:
            raise EndOfFileError
        return data

    def seek(self, offset: int, whence: int = SEEK_SET) -> int:
        """As of any stream."""
        return self._stream.seek(offset, whence)

    def tell(self) -> int:
        """As of any stream."""
        return self._stream.tell()

    def seekable(self) -> bool:
        """Always."""
        return True

    def close(self) -> None:
        """As of any stream."""
        self._stream.close()
