# SPDX-License-Identifier: Apache-2.0
"""Recordings of chunks with an index, and those without index, as a killed recorder leaves them.

Their files are read by `ExactReader`, whose reads are complete or fail.
"""

from __future__ import annotations

import errno
import heapq
import os
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence, Sized
from contextlib import closing, suppress
from dataclasses import dataclass, field
from io import BufferedReader, RawIOBase
from itertools import count
from operator import attrgetter, itemgetter
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
    joint_span,
    joint_topics,
)
from multilica.ingest.remote.remote_file import SourceFile

Part = tuple[int, Iterator[RawMessage]]
"""Position behind a record of the file, and the messages of the record, which may be a chunk."""

_MAX_KEPT_BYTES = 128 << 20
"""Recordings up to this size are kept in memory, as finding out what a file holds takes as long as reading it."""
_MARK_BYTES = 1 << 20
"""Distance of the positions that are remembered to start at."""
_MAX_WAITING_BYTES = 256 << 20
"""Chunks that overlap in time wait for each other up to this size; above it, messages are no longer sorted."""
_WAITING_MESSAGE_BYTES, _KEPT_MESSAGE_BYTES = 512, 256
"""Memory of a message besides its data."""
_MAX_BACK_NS = 2 * 10**9
"""Recorders write messages of several threads a little out of order."""
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


@dataclass(slots=True)
class Survey:
    """The contents of a recording.

    Args:
        counts: messages by topic; the topics' own counts are zero.
        spans: log times by name of the topic.
        marks: positions in the file, each with the latest log time before it.
        goes_back, is_sorted: some of it is much older than what lies before it; each topic alone is in order.
    """

    counts: Counter[Topic] = field(default_factory=Counter)
    spans: dict[str, Span] = field(default_factory=dict)
    unpacked_bytes: int = 0
    damage: str = ""
    latest_ns: int = 0
    marks: list[tuple[int, int]] = field(default_factory=list)
    goes_back: bool = False
    is_sorted: bool = True

    def begin_part(self, first_ns: int) -> None:
        """Note the earliest log time of what is added next."""
        self.goes_back |= first_ns < self.latest_ns - _MAX_BACK_NS

    def add(self, topic: Topic, count: int, span: Span, unpacked_bytes: int = 0) -> None:
        """Add `count` messages of a topic."""
        self.counts[topic] += count
        first, last = self.spans.get(topic.name, span)
        self.is_sorted &= topic.name not in self.spans or span[0] >= last - _MAX_BACK_NS
        self.spans[topic.name] = min(first, span[0]), max(last, span[1])
        self.unpacked_bytes += unpacked_bytes
        self.latest_ns = max(self.latest_ns, span[1])

    def add_message(self, message: RawMessage, unpacked_bytes: int = 0) -> None:
        """Add one message."""
        topic = Topic(message.topic, message.message_type, message.encoding, lidar=message.lidar)
        self.begin_part(message.log_time_ns)
        self.add(topic, 1, (message.log_time_ns, message.log_time_ns), unpacked_bytes)

    def mark(self, place: int) -> None:
        """Remember a position; everything before it was added."""
        if place - (self.marks[-1][0] if self.marks else 0) >= _MARK_BYTES:
            self.marks.append((place, self.latest_ns))

    def begin(self, start_ns: int) -> int:
        """Return the last known position with only messages before `start_ns` in front of it."""
        index = bisect_left(self.marks, start_ns, key=itemgetter(1))
        return self.marks[index - 1][0] if index else 0


class UnindexedRecording(Recording):
    """A recording that is read from the front up to the first damage.

    Args:
        scan: yields the parts of the file from a position on, in the order of writing; raises any error where it
            cannot go on. It starts at 0 or where it has been before.
        survey: finds out what the file holds without that; returns None if it cannot.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """

    is_indexed = False

    def __init__(
        self,
        title: str,
        where: str,
        scan: Callable[[int], Iterator[Part]],
        survey: Callable[[], Survey | None] = lambda: None,
    ) -> None:
        self.format = title
        self._where = where
        self._scan = scan
        self._kept: list[RawMessage] | None = None
        self._error: DamagedRecordingError | None = None
        found = survey()
        self._survey = self._read() if found is None or found.unpacked_bytes <= _MAX_KEPT_BYTES else found
        self.topics = joint_topics(self._survey.counts.items())
        self.damage = self._survey.damage

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Return the span, which is known since the file was opened."""
        return joint_span(span for name, span in self._survey.spans.items() if name in topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield messages in the order of writing; by log time if the topics were written one after the other."""
        errors: list[DamagedRecordingError] = []
        # A clock that was set back goes back within each topic, too.
        is_by_topic = self._survey.goes_back and self._survey.is_sorted
        parts = [{topic} for topic in sorted(topics)] if is_by_topic else [{*topics}]
        yield from heapq.merge(
            *(self._written(each, start_ns, errors) for each in parts), key=attrgetter("log_time_ns")
        )
        if errors:
            raise errors[0]

    def _written(self, topics: Collection[str], start_ns: int, errors: list[DamagedRecordingError]) -> Messages:
        """Yield messages in the order of writing; add what ends them too early to the errors."""
        try:
            with damage_named(self._where):
                parts = self._scan(self._survey.begin(start_ns)) if self._kept is None else [(0, iter(self._kept))]
                for _, messages in parts:
                    yield from (each for each in messages if each.topic in topics and each.log_time_ns >= start_ns)
        except DamagedRecordingError as error:
            errors.append(error)
        if self._error is not None:
            errors.append(self._error)

    def _read(self) -> Survey:
        found, kept, kept_bytes = Survey(), list[RawMessage](), 0
        try:
            with damage_named(self._where):
                for behind, messages in self._scan(0):
                    chunk: Sized | None = None
                    for message in messages:
                        found.add_message(message)
                        # A message keeps all of its chunk in memory.
                        before, chunk = chunk, _chunk_of(message)
                        kept_bytes += _KEPT_MESSAGE_BYTES + (0 if chunk is before else len(chunk))
                        if kept_bytes <= _MAX_KEPT_BYTES:
                            kept.append(message)
                        else:
                            kept.clear()
                    found.mark(behind)
        except DamagedRecordingError as error:
            if not found.counts:
                raise
            found.damage, self._error = error.reason, error
        self._kept = kept if kept_bytes <= _MAX_KEPT_BYTES else None
        return found


def _chunk_of(message: RawMessage) -> Sized:
    return cast(Sized, message.data.obj) if isinstance(message.data, memoryview) else message.data
