# SPDX-License-Identifier: Apache-2.0
"""MCAP's records in the terms of `recording`."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from multilica.ingest.chunked import PackedChunk
from multilica.ingest.recording import Message, Span, Topic, normal_type
from multilica.ingest.reused_memory import ReusedMemory
from multilica.ingest.unpacking import MAX_RECORDS, MAX_UNPACKED_BYTES
from multilica.ingest.whole_reads import EndOfFileError
from multilica.pointcloud2 import LIDAR_NAME_KEY

__all__ = [
    "MAGIC",
    "MESSAGE_HEAD",
    "RECORD_HEAD",
    "KnownChannels",
    "Stream",
    "chunk_claims",
    "chunk_of",
    "record_length",
    "records_of",
    "stream_of",
    "topics_of",
]

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
"""Opcode and length of what follows."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence, log time, publish time: what comes before the message's own bytes."""
_CHUNK_HEAD = struct.Struct("<QQQII")
_LENGTH = struct.Struct("<Q")
_MAX_RECORD_BYTES = MAX_UNPACKED_BYTES + (1 << 10)


@dataclass(frozen=True, slots=True)
class Stream:
    """What a channel and its schema say about each of their messages."""

    topic: str
    message_type: str
    encoding: str
    lidar: str
    origin: str

    @property
    def topic_alone(self) -> Topic:
        """The topic, no messages counted."""
        return Topic(self.topic, self.message_type, self.encoding, 0, self.lidar)

    def message(self, record: memoryview, log_time_ns: int) -> Message:
        """The message in a record, its bytes untouched."""
        data = record[MESSAGE_HEAD.size :]
        return Message(self.topic, self.message_type, self.encoding, log_time_ns, data, self.origin, self.lidar)


def records_of(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Opcode and content of each record, without a copy.

    Raises:
        EndOfFileError: a record is longer than what is there.
        ValueError: there are more than a chunk can sanely hold; the text is a clause.
    """
    place = 0
    for _ in range(MAX_RECORDS):
        if place == len(data):
            return
        if len(data) - place < RECORD_HEAD.size:
            raise EndOfFileError
        opcode, length = RECORD_HEAD.unpack_from(data, place)
        place += RECORD_HEAD.size
        if length > len(data) - place or (opcode == Opcode.MESSAGE and length < MESSAGE_HEAD.size):
            raise EndOfFileError
        yield opcode, data[place : place + length]
        place += length
    raise ValueError("a chunk holds an impossible number of records")


def record_length(head: bytes) -> tuple[int, int]:
    """Opcode and length of a record that is to be read into memory.

    Raises:
        ValueError: it is larger than any that is sane; the text is a clause.
    """
    opcode, length = RECORD_HEAD.unpack(head)
    if length > _MAX_RECORD_BYTES:
        raise ValueError("a record claims an impossible size")
    return opcode, length


def chunk_of(record: memoryview) -> PackedChunk:
    """The chunk in a record, still packed; of one that was cut off, its beginning.

    Raises:
        EndOfFileError: it ends before its data begin, or before its record does.
    """
    if len(record) < _CHUNK_HEAD.size:
        raise EndOfFileError
    _, _, size, crc32, name_bytes = _CHUNK_HEAD.unpack_from(record)
    end = _CHUNK_HEAD.size + name_bytes
    if end + _LENGTH.size > len(record):
        raise EndOfFileError
    (length,) = _LENGTH.unpack_from(record, end)
    data = record[end + _LENGTH.size :]
    if length < len(data):
        raise EndOfFileError
    compression = str(record[_CHUNK_HEAD.size : end], "utf-8")
    return PackedChunk(compression, data, size, crc32, is_whole=length == len(data))


def chunk_claims(record: bytes) -> tuple[Span, int]:
    """Log times of the first and the last message of a chunk, and its unpacked size, as the head of its record says.

    Raises:
        EndOfFileError: the record ends within its head.
    """
    if len(record) < _CHUNK_HEAD.size:
        raise EndOfFileError
    first_ns, last_ns, size, _, _ = _CHUNK_HEAD.unpack_from(record)
    return (first_ns, last_ns), size


class KnownChannels:
    """The schemas and channels that were met so far on the way through a file.

    Args:
        where: the file, for messages.
    """

    def __init__(self, where: str) -> None:
        self.streams: dict[int, Stream] = {}
        self.where = where
        self._schemas: dict[int, Schema] = {}
        self._memory = ReusedMemory()

    def messages_of(self, opcode: int, record: memoryview) -> Iterator[Message]:
        """The messages of a record, be it one or a chunk of many; what else it holds is learned."""
        records = records_of(chunk_of(record).unpack(self._memory)) if opcode == Opcode.CHUNK else [(opcode, record)]
        for inner_opcode, inner in records:
            if inner_opcode == Opcode.MESSAGE:
                channel, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(inner)
                yield self.streams[channel].message(inner, log_time_ns)
            else:
                self.learn(inner_opcode, inner)

    def learn(self, opcode: int, record: memoryview) -> None:
        """Remember a schema or a channel."""
        if opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(record)))
            self.streams[channel.id] = stream_of(channel, self._schemas, self.where)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(record)))
            self._schemas[schema.id] = schema


def stream_of(channel: Channel, schemas: Mapping[int, Schema], where: str) -> Stream:
    """What the messages of a channel have in common."""
    schema = schemas.get(channel.schema_id)
    return Stream(
        channel.topic,
        "without schema" if schema is None else normal_type(schema.name),
        channel.message_encoding,
        channel.metadata.get(LIDAR_NAME_KEY, ""),
        f"In {where}, a scan of '{channel.topic}'",
    )


def topics_of(streams: Mapping[int, Stream], counts: Mapping[int, int]) -> tuple[Topic, ...]:
    """Topics by name; `counts` holds the messages per channel id."""
    totals: Counter[tuple[str, str, str, str]] = Counter()
    for number, stream in streams.items():
        totals[stream.topic, stream.message_type, stream.encoding, stream.lidar] += counts.get(number, 0)
    return tuple(Topic(*key[:3], count, key[3]) for key, count in sorted(totals.items()))
