# SPDX-License-Identifier: Apache-2.0
"""Records of MCAP files.

Functions raise `EndOfFileError` if data end too early, and ValueError, with a clause as its text, if they are wrong.
"""

import struct
from collections.abc import Iterator, Mapping
from io import BytesIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Schema

from multilica.ingest.containers.chunked import PackedChunk
from multilica.ingest.containers.exact_reader import EndOfFileError, unpack_head
from multilica.ingest.decompression import MAX_RECORDS, MAX_UNPACKED_BYTES
from multilica.ingest.formats import FORMATS
from multilica.ingest.recording import RawMessage, Span, Topic, normal_type
from multilica.pointcloud2 import LIDAR_NAME_KEY

(MAGIC,) = FORMATS["mcap"].magic
RECORD_HEAD = struct.Struct("<BQ")
"""Opcode, length of the content."""
MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence, log time, publish time; the message's data follow."""
_CHUNK_HEAD = struct.Struct("<QQQII")
_LENGTH = struct.Struct("<Q")
_MAX_RECORD_BYTES = MAX_UNPACKED_BYTES + (1 << 10)


def records_of(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield opcode and content of each record, without a copy; at most `MAX_RECORDS`."""
    place = 0
    for _ in range(MAX_RECORDS):
        if place == len(data):
            return
        opcode, length = unpack_head(RECORD_HEAD, data, place)
        place += RECORD_HEAD.size
        require_opcode(opcode, length)
        if length > len(data) - place or (opcode == Opcode.MESSAGE and length < MESSAGE_HEAD.size):
            raise EndOfFileError
        yield opcode, data[place : place + length]
        place += length
    raise ValueError("a chunk holds an impossible number of records")


def require_opcode(opcode: int, length: int) -> None:
    """Raise ValueError for what no writer writes: zeros, and records without content but the end of the file."""
    if opcode == 0 or (length == 0 and opcode != Opcode.FOOTER):
        raise ValueError("its records make no sense")


def record_length(head: bytes) -> tuple[int, int]:
    """Return opcode and length in bytes of a record that is to be read into memory."""
    opcode, length = RECORD_HEAD.unpack(head)
    if length > _MAX_RECORD_BYTES:
        raise ValueError("a record claims an impossible size")
    return opcode, length


def chunk_of(record: memoryview) -> PackedChunk:
    """Return the chunk in a record; its beginning if the record was cut off."""
    _, _, size, crc32, name_bytes = unpack_head(_CHUNK_HEAD, record)
    end = _CHUNK_HEAD.size + name_bytes
    (length,) = unpack_head(_LENGTH, record, end)
    data = record[end + _LENGTH.size :]
    if length < len(data):
        raise EndOfFileError
    compression = str(record[_CHUNK_HEAD.size : end], "utf-8")
    return PackedChunk(compression, data, size, crc32, is_whole=length == len(data))


def chunk_claims(record: bytes) -> tuple[Span, int]:
    """Return the span of a chunk and its unpacked size in bytes, as the head of its record claims."""
    first_ns, last_ns, size, _, _ = unpack_head(_CHUNK_HEAD, record)
    return (first_ns, last_ns), size


def topic_of(channel: Channel, schemas: Mapping[int, Schema]) -> Topic:
    """Return the topic of a channel, without a count."""
    schema = schemas.get(channel.schema_id)
    message_type = "without schema" if schema is None else normal_type(schema.name)
    return Topic(channel.topic, message_type, channel.message_encoding, lidar=channel.metadata.get(LIDAR_NAME_KEY, ""))


class KnownChannels:
    """The schemas and channels met so far on the way through a file."""

    def __init__(self, where: str) -> None:
        self.topics: dict[int, Topic] = {}
        self.where = where
        self._schemas: dict[int, Schema] = {}

    def messages_of(self, opcode: int, record: memoryview) -> Iterator[RawMessage]:
        """Yield the messages of a record or chunk; learn its schemas and channels."""
        records = records_of(chunk_of(record).unpack()) if opcode == Opcode.CHUNK else [(opcode, record)]
        for inner_opcode, inner in records:
            if inner_opcode == Opcode.MESSAGE:
                channel, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(inner)
                yield self.topics[channel].message(log_time_ns, inner[MESSAGE_HEAD.size :], self.where)
            else:
                self.learn(inner_opcode, inner)

    def learn(self, opcode: int, record: memoryview) -> None:
        """Remember a schema or a channel; ignore other records."""
        if opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(record)))
            self.topics[channel.id] = topic_of(channel, self._schemas)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(record)))
            self._schemas[schema.id] = schema
