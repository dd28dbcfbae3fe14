# SPDX-License-Identifier: Apache-2.0
"""Recordings of chunks with an index.

Their files are read by `ExactReader`, whose reads are complete or fail.
"""

from __future__ import annotations

import errno
import heapq
import os
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from io import BufferedReader, RawIOBase
from itertools import count
from struct import Struct
from typing import Any, cast

from multilica.ingest.decompression import require_checksum, unpack
from multilica.ingest.memory import memory_budget
from multilica.ingest.recording import (
    DamagedRecordingError,
    Messages,
    RawMessage,
    Recording,
    Span,
    Topic,
    damage_named,
)
from multilica.ingest.remote.remote_file import SourceFile

_MAX_WAITING_BYTES = 256 << 20
"""Chunks that overlap in time wait for each other up to this size; above it, messages are no longer sorted."""
_WAITING_MESSAGE_BYTES = 512
"""Memory of a message besides its data."""
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


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """A chunk according to the index; `topics` is None if the index does not tell."""

    offset: int
    start_ns: int
    end_ns: int
    topics: frozenset[str] | None


@dataclass(frozen=True, slots=True, eq=False)
class PackedChunk:
    """A chunk as stored in the file.

    Args:
        size, crc32: of the unpacked data.
        is_whole: False if the file ends within it.
    """

    compression: str
    data: bytes | memoryview
    size: int
    crc32: int = 0
    is_whole: bool = True

    def unpack(self) -> memoryview:
        """Return its records, or those at its beginning if it is not whole; raise ValueError if they are broken."""
        data = unpack(self.compression, self.data, self.size, partial=not self.is_whole)
        if self.is_whole:
            require_checksum(data, self.crc32)
        return data


@dataclass(eq=False)
class ChunkedRecording(Recording):
    """A recording of which only the needed chunks are read.

    Args:
        chunks: in any order.
        read_chunk: reads the chunk at a place from the stream.
        split: yields the messages on the given topics from the records of a chunk.
    """

    format: str
    where: str
    stream: ExactReader
    topics: tuple[Topic, ...]
    chunks: Sequence[ChunkPlace]
    read_chunk: Callable[[ExactReader, ChunkPlace], PackedChunk]
    split: Callable[[memoryview, Collection[str]], Iterator[RawMessage]]

    def __post_init__(self) -> None:
        self.chunks = sorted(self.chunks, key=lambda chunk: (chunk.start_ns, chunk.offset))

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Return the span, read from the first and the last chunks with one of the topics."""
        with closing(self.messages(topics)) as messages:
            first = next(messages, None)
        if first is None:
            return None
        last_ns = first.log_time_ns
        for chunk in sorted(self._chunks_with(topics, 0), key=lambda chunk: -chunk.end_ns):
            if chunk.end_ns <= last_ns:
                break
            for message in self._messages_of(chunk, *self._records_of(chunk), topics, 0):
                last_ns = max(last_ns, message.log_time_ns)
        return first.log_time_ns, last_ns

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield messages by log time; for a damaged chunk, one with a fault on each topic."""
        chunks = self._chunks_with(topics, start_ns)
        starts = [*(chunk.start_ns for chunk in chunks[1:]), 2**64]  # the end of time
        waiting: list[tuple[int, int, RawMessage]] = []
        waiting_bytes = 0
        number = count()
        memory = memory_budget()
        try:
            for chunk, next_start_ns in zip(chunks, starts, strict=False):
                records, fault = self._records_of(chunk)
                waiting_bytes += len(records)
                for message in self._messages_of(chunk, records, fault, topics, start_ns):
                    if message.log_time_ns >= start_ns:
                        memory.take(_WAITING_MESSAGE_BYTES)
                        heapq.heappush(waiting, (message.log_time_ns, next(number), message))
                crowded = waiting_bytes > _MAX_WAITING_BYTES
                while waiting and (crowded or waiting[0][0] <= next_start_ns):
                    memory.give(_WAITING_MESSAGE_BYTES)
                    yield heapq.heappop(waiting)[2]
                waiting_bytes *= bool(waiting)
        finally:  # a reader may stop early
            memory.give(_WAITING_MESSAGE_BYTES * len(waiting))

    def close(self) -> None:
        """Close the file."""
        self.stream.close()

    def _chunks_with(self, topics: Collection[str], start_ns: int) -> list[ChunkPlace]:
        wanted = frozenset(topics)
        return [
            chunk
            for chunk in self.chunks
            if chunk.end_ns >= start_ns and (chunk.topics is None or chunk.topics & wanted)
        ]

    def _records_of(self, chunk: ChunkPlace) -> tuple[memoryview, str]:
        """Return the records of a chunk, and why it has none."""
        try:
            with damage_named(self.where):
                return self.read_chunk(self.stream, chunk).unpack(), ""
        except DamagedRecordingError as error:
            return memoryview(b""), error.reason

    def _messages_of(
        self, chunk: ChunkPlace, records: memoryview, fault: str, topics: Collection[str], start_ns: int
    ) -> Iterator[RawMessage]:
        """Yield the readable messages, then one with a fault on each topic that may have lost some.

        Its time is not before the start, so that damage of a chunk that begins earlier is told.
        """
        try:
            with damage_named(self.where):
                yield from self.split(records, topics)
        except DamagedRecordingError as error:
            fault = error.reason
        for topic in self.topics if fault else ():
            if topic.name in topics and (chunk.topics is None or topic.name in chunk.topics):
                lost = f"lies where the file is damaged: {fault}"
                yield topic.message(max(chunk.start_ns, start_ns), b"", self.where, fault=lost)
