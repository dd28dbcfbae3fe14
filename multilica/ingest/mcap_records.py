# SPDX-License-Identifier: Apache-2.0
"""MCAP's records in the terms of `recording`."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from multilica.ingest.chunked import PackedChunk
from multilica.ingest.recording import Message, Topic, normal_type
from multilica.ingest.unpacking import MAX_RECORDS, MAX_UNPACKED_BYTES
from multilica.ingest.whole_reads import EndOfFileError
from multilica.pointcloud2 import LIDAR_NAME_KEY

__all__ = [
    "MESSAGE_HEAD",
    "RECORD_HEAD",
    "Stream",
    "channel_of",
    "chunk_of",
    "record_length",
    "records_of",
    "schema_of",
    "stream_of",
    "topics_of",
]

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


def channel_of(record: memoryview) -> Channel:
    """The channel in a record."""
    channel: Channel = Channel.read(ReadDataStream(BytesIO(record)))
    return channel


def schema_of(record: memoryview) -> Schema:
    """The schema in a record."""
    schema: Schema = Schema.read(ReadDataStream(BytesIO(record)))
    return schema


def stream_of(channel: Channel, schemas: Mapping[int, Schema], path: Path | str) -> Stream:
    """What the messages of a channel have in common."""
    schema = schemas.get(channel.schema_id)
    return Stream(
        channel.topic,
        "without schema" if schema is None else normal_type(schema.name),
        channel.message_encoding,
        channel.metadata.get(LIDAR_NAME_KEY, ""),
        f"In {path}, a scan of '{channel.topic}'",
    )


def topics_of(streams: Mapping[int, Stream], counts: Mapping[int, int]) -> tuple[Topic, ...]:
    """Topics by name; `counts` holds the messages per channel id."""
    totals: Counter[tuple[str, str, str, str]] = Counter()
    for number, stream in streams.items():
        totals[stream.topic, stream.message_type, stream.encoding, stream.lidar] += counts.get(number, 0)
    return tuple(Topic(*key[:3], count, key[3]) for key, count in sorted(totals.items()))
