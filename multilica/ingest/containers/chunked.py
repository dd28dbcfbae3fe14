# SPDX-License-Identifier: Apache-2.0
"""Recordings of chunks with an index."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from contextvars import copy_context
from dataclasses import dataclass
from functools import partial
from itertools import count

from multilica.ingest.containers.exact_reader import ExactReader
from multilica.ingest.decompression import UNCOMPRESSED, require_checksum, unpack
from multilica.ingest.memory import memory_budget
from multilica.ingest.recording import DamagedRecordingError, Messages, RawMessage, Span, Topic, damage_named

_AHEAD = 1
"""Compressed chunks that are unpacked ahead; see docs/decisions/0005-chunks-unpacked-ahead.md."""
_MAX_RATIO = 0.9
"""Only chunks compressed below this share of their size are worth a thread; base64, for one, is only copied."""
_MAX_WAITING_BYTES = 256 << 20
"""Chunks that overlap in time wait for each other up to this size; above it, messages are no longer sorted."""
_MESSAGE_BYTES = 512
"""Memory of a waiting message besides its data."""
_END_OF_TIME = 2**64
_NOTHING = memoryview(b"")


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

    @property
    def is_worth_a_thread(self) -> bool:
        """True if unpacking does more than copy and check the data."""
        return self.compression not in UNCOMPRESSED and len(self.data) < _MAX_RATIO * self.size

    def unpack(self) -> memoryview:
        """Return its records, or those at its beginning if it is not whole; raise ValueError if they are broken."""
        data = unpack(self.compression, self.data, self.size, partial=not self.is_whole)
        if self.is_whole:
            require_checksum(data, self.crc32)
        return data


class ChunkedRecording:
    """A recording of which only the needed chunks are read.

    Args:
        chunks: in any order.
        read_chunk: reads the chunk at a place from the stream.
        split: yields the messages on the given topics from the records of a chunk.
    """

    damage = ""
    is_indexed = True

    def __init__(
        self,
        title: str,
        where: str,
        stream: ExactReader,
        topics: tuple[Topic, ...],
        chunks: Iterable[ChunkPlace],
        read_chunk: Callable[[ExactReader, ChunkPlace], PackedChunk],
        split: Callable[[memoryview, Collection[str]], Iterator[RawMessage]],
    ) -> None:
        self.format = title
        self.topics = topics
        self._where = where
        self._stream = stream
        self._chunks = sorted(chunks, key=lambda chunk: (chunk.start_ns, chunk.offset))
        self._read_chunk = read_chunk
        self._split = split

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
            for message in self._messages_of(self._unpack(chunk, self._read(chunk)), topics):
                last_ns = max(last_ns, message.log_time_ns)
        return first.log_time_ns, last_ns

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield messages by log time; for a damaged chunk, one with a fault on each topic."""
        chunks = self._chunks_with(topics, start_ns)
        starts = [*(chunk.start_ns for chunk in chunks[1:]), _END_OF_TIME]
        waiting: list[tuple[int, int, RawMessage]] = []
        waiting_bytes = 0
        number = count()
        memory = memory_budget()
        with closing(self._unpacked(chunks)) as unpacked:
            for part, next_start_ns in zip(unpacked, starts, strict=False):
                waiting_bytes += len(part.records)
                for message in self._messages_of(part, topics):
                    if message.log_time_ns >= start_ns:
                        memory.take(_MESSAGE_BYTES)
                        heapq.heappush(waiting, (message.log_time_ns, next(number), message))
                crowded = waiting_bytes > _MAX_WAITING_BYTES
                while waiting and (crowded or waiting[0][0] <= next_start_ns):
                    memory.give(_MESSAGE_BYTES)
                    yield heapq.heappop(waiting)[2]
                waiting_bytes *= bool(waiting)

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def _chunks_with(self, topics: Collection[str], start_ns: int) -> list[ChunkPlace]:
        wanted = frozenset(topics)
        return [
            chunk
            for chunk in self._chunks
            if chunk.end_ns >= start_ns and (chunk.topics is None or chunk.topics & wanted)
        ]

    def _unpacked(self, chunks: Sequence[ChunkPlace]) -> Generator[_Unpacked, None, None]:
        """Yield the records of each chunk; another thread unpacks the next compressed chunk meanwhile."""
        ahead: deque[Callable[[], _Unpacked]] = deque()
        with ThreadPoolExecutor(max_workers=1) as thread:
            for place in chunks:
                chunk = self._read(place)
                threaded = isinstance(chunk, PackedChunk) and chunk.is_worth_a_thread
                unpack = partial(self._unpack, place, chunk)
                ahead.append(thread.submit(copy_context().run, unpack).result if threaded else unpack)
                while len(ahead) > (_AHEAD if threaded else 0):
                    yield ahead.popleft()()
            while ahead:
                yield ahead.popleft()()

    def _read(self, place: ChunkPlace) -> PackedChunk | str:
        """Return a chunk, or why it cannot be read."""
        try:
            with damage_named(self._where):
                return self._read_chunk(self._stream, place)
        except DamagedRecordingError as error:
            return error.reason

    def _unpack(self, place: ChunkPlace, chunk: PackedChunk | str) -> _Unpacked:
        if isinstance(chunk, str):
            return _Unpacked(place, _NOTHING, chunk)
        try:
            with damage_named(self._where):
                return _Unpacked(place, chunk.unpack())
        except DamagedRecordingError as error:
            return _Unpacked(place, _NOTHING, error.reason)

    def _messages_of(self, part: _Unpacked, topics: Collection[str]) -> Iterator[RawMessage]:
        """Yield the readable messages, then one with a fault on each topic that may have lost some."""
        fault = part.fault
        try:
            with damage_named(self._where):
                yield from self._split(part.records, topics)
        except DamagedRecordingError as error:
            fault = error.reason
        for topic in self.topics if fault else ():
            if topic.name in topics and (part.chunk.topics is None or topic.name in part.chunk.topics):
                lost = f"lies where the file is damaged: {fault}"
                yield topic.message(part.chunk.start_ns, b"", self._where, fault=lost)


@dataclass(frozen=True, slots=True, eq=False)
class _Unpacked:
    """The records of a chunk, or why there are none."""

    chunk: ChunkPlace
    records: memoryview
    fault: str = ""
