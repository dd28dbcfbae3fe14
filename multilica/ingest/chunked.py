# SPDX-License-Identifier: Apache-2.0
"""Recordings whose messages lie in chunks that an index tells of."""

from __future__ import annotations

import heapq
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import dataclass
from itertools import count

from multilica.ingest.damage import DamagedRecordingError, damage_named
from multilica.ingest.recording import Message, Messages, Span, Topic
from multilica.ingest.reused_memory import ReusedMemory
from multilica.ingest.unpacking import UNCOMPRESSED, require_checksum, unpack
from multilica.ingest.whole_reads import WholeReads

__all__ = ["ChunkPlace", "ChunkedRecording", "PackedChunk"]

_AHEAD = 1
"""Compressed chunks that are unpacked ahead; see docs/decisions/0005-chunks-unpacked-ahead.md."""
_MOST_PACKED = 0.9
"""Share of its size below which a chunk takes long enough to unpack; base64, for one, is only copied."""
_MAX_WAITING_BYTES = 256 << 20
"""Chunks that overlap in time are held back together up to this size; beyond, order gives way."""
_END_OF_TIME = 2**64
_NOTHING = memoryview(b"")


@dataclass(frozen=True, slots=True)
class ChunkPlace:
    """Where a chunk lies, as the index says.

    Args:
        offset: of the chunk in its file.
        start_ns, end_ns: log times of its first and last message.
        topics: whose messages it holds; None if the index does not tell.
    """

    offset: int
    start_ns: int
    end_ns: int
    topics: frozenset[str] | None


@dataclass(frozen=True, slots=True, eq=False)
class PackedChunk:
    """A chunk as it lies in the file.

    Args:
        size, crc32: of the unpacked data.
        is_whole: False where the file ends within it.
    """

    compression: str
    data: bytes | memoryview
    size: int
    crc32: int = 0
    is_whole: bool = True

    @property
    def is_worth_a_thread(self) -> bool:
        """There is more to do than to copy and to check it."""
        return self.compression not in UNCOMPRESSED and len(self.data) < _MOST_PACKED * self.size

    def unpack(self, memory: ReusedMemory) -> memoryview:
        """Its records; of one that is not whole, those at its beginning, unchecked.

        Raises:
            ValueError: the data are broken; the text is a clause.
        """
        data = unpack(self.compression, self.data, self.size, memory, partial=not self.is_whole)
        if self.is_whole:
            require_checksum(data, self.crc32)
        return data


class ChunkedRecording:
    """A recording of which only the chunks that are needed are read.

    Args:
        title: as `Recording.format`.
        where: the file, for messages.
        chunks: in any order.
        read_chunk: reads the chunk at a place from the stream.
        split: the messages in the records of a chunk, on these topics.
    """

    damage = ""
    is_indexed = True

    def __init__(
        self,
        title: str,
        where: str,
        stream: WholeReads,
        topics: tuple[Topic, ...],
        chunks: Iterable[ChunkPlace],
        read_chunk: Callable[[WholeReads, ChunkPlace], PackedChunk],
        split: Callable[[memoryview, Collection[str]], Iterator[Message]],
    ) -> None:
        self.format = title
        self.topics = topics
        self._where = where
        self._stream = stream
        self._chunks = sorted(chunks, key=lambda chunk: (chunk.start_ns, chunk.offset))
        self._read_chunk = read_chunk
        self._split = split
        self._memory = ReusedMemory()

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Read from the first and the last chunks that hold one of the topics."""
        with closing(self.messages(topics)) as messages:
            first = next(messages, None)
        if first is None:
            return None
        last_ns = first.log_time_ns
        for chunk in sorted(self._chunks_with(topics, 0), key=lambda chunk: -chunk.end_ns):
            if chunk.end_ns <= last_ns:
                break
            for message in self._messages_of(self._begun(chunk)(), topics):
                last_ns = max(last_ns, message.log_time_ns)
        return first.log_time_ns, last_ns

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """In the order of log times; in place of those in a chunk that is damaged, one with a fault on each topic."""
        chunks = self._chunks_with(topics, start_ns)
        starts = [*(chunk.start_ns for chunk in chunks[1:]), _END_OF_TIME]
        waiting: list[tuple[int, int, Message]] = []
        waiting_bytes = 0
        number = count()
        with closing(self._unpacked(chunks)) as unpacked:
            for part, next_start_ns in zip(unpacked, starts, strict=False):
                waiting_bytes += len(part.records)
                for message in self._messages_of(part, topics):
                    if message.log_time_ns >= start_ns:
                        heapq.heappush(waiting, (message.log_time_ns, next(number), message))
                crowded = waiting_bytes > _MAX_WAITING_BYTES
                while waiting and (crowded or waiting[0][0] <= next_start_ns):
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

    def _unpacked(self, chunks: Sequence[ChunkPlace]) -> Generator[_Part, None, None]:
        """The records of each chunk; a compressed one is unpacked by another thread while the one before is used."""
        ahead: deque[Callable[[], _Part]] = deque()
        with ThreadPoolExecutor(max_workers=1) as aside:
            for chunk in chunks:
                unpack = self._begun(chunk)
                if unpack.is_worth_a_thread:
                    ahead.append(aside.submit(unpack).result)
                else:
                    ahead.append(unpack)
                while len(ahead) > (_AHEAD if unpack.is_worth_a_thread else 0):
                    yield ahead.popleft()()
            while ahead:
                yield ahead.popleft()()

    def _begun(self, chunk: ChunkPlace) -> _Unpacking:
        try:
            with damage_named(self._where):
                return _Unpacking(chunk, self._where, self._memory, self._read_chunk(self._stream, chunk))
        except DamagedRecordingError as error:
            return _Unpacking(chunk, self._where, self._memory, None, error.reason)

    def _messages_of(self, part: _Part, topics: Collection[str]) -> Iterator[Message]:
        """Those of a chunk that can be read, then one with a fault on each topic that may have lost some."""
        fault = part.fault
        try:
            with damage_named(self._where):
                yield from self._split(part.records, topics)
        except DamagedRecordingError as error:
            fault = error.reason
        if fault:
            yield from self._lost(part.chunk, fault, topics)

    def _lost(self, chunk: ChunkPlace, fault: str, topics: Collection[str]) -> Iterator[Message]:
        for topic in self.topics:
            if topic.name in topics and (chunk.topics is None or topic.name in chunk.topics):
                yield Message(
                    topic.name,
                    topic.message_type,
                    topic.encoding,
                    chunk.start_ns,
                    b"",
                    f"In {self._where}, a scan of '{topic.name}'",
                    topic.lidar,
                    f"lies where the file is damaged: {fault}",
                )


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """The records of a chunk, or why there are none."""

    chunk: ChunkPlace
    records: memoryview
    fault: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class _Unpacking:
    """What is left to do with a chunk that was read, or could not be: `packed` is None, and `fault` says why."""

    chunk: ChunkPlace
    where: str
    memory: ReusedMemory
    packed: PackedChunk | None
    fault: str = ""

    @property
    def is_worth_a_thread(self) -> bool:
        return self.packed is not None and self.packed.is_worth_a_thread

    def __call__(self) -> _Part:
        if self.packed is None:
            return _Part(self.chunk, _NOTHING, self.fault)
        try:
            with damage_named(self.where):
                return _Part(self.chunk, self.packed.unpack(self.memory))
        except DamagedRecordingError as error:
            return _Part(self.chunk, _NOTHING, error.reason)
