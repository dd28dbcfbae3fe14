# SPDX-License-Identifier: Apache-2.0
"""Records of ROS 1 bags.

Functions raise `EndOfFileError` if data end too early, and ValueError, with a clause as its text, if they are wrong.
"""

import struct
from collections.abc import Iterable, Iterator, Mapping
from typing import TypeAlias

from multilica.ingest.containers.chunked import PackedChunk
from multilica.ingest.containers.exact_reader import EndOfFileError, ExactReader, unpack_head
from multilica.ingest.decompression import MAX_RECORDS, MAX_UNPACKED_BYTES
from multilica.ingest.recording import RawMessage, Topic, normal_type

MAGIC_BYTES = len(b"#ROSBAG V2.0\n")
CHUNK, CHUNK_INFO, CONNECTION = 5, 6, 7
_MESSAGE = 2

RecordHeader: TypeAlias = Mapping[bytes, bytes]

_LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")


def connection_topic(header: RecordHeader, data: memoryview) -> Topic:
    """Return the topic in a connection record, without a count."""
    return Topic(header[b"topic"].decode(), normal_type(_fields(data)[b"type"].decode()), "ros1")


def messages_of(
    records: Iterable[tuple[RecordHeader, memoryview]], topics: dict[bytes, Topic], where: str
) -> Iterator[RawMessage]:
    """Yield the messages in records; add connections in the records to `topics`."""
    for header, data in records:
        if header[b"op"][0] == CONNECTION:
            topics[header[b"conn"]] = connection_topic(header, data)
        elif header[b"op"][0] == _MESSAGE:
            yield topics[header[b"conn"]].message(time_ns(header[b"time"]), data, where)


def time_ns(field: bytes | memoryview) -> int:
    """Return nanoseconds since the epoch."""
    seconds, nanoseconds = _TIME.unpack(field)
    return int(seconds) * 10**9 + int(nanoseconds)


def read_length(stream: ExactReader) -> int:
    """Read the length in bytes of what follows."""
    (length,) = _LENGTH.unpack(stream.read(_LENGTH.size))
    if length > MAX_UNPACKED_BYTES:
        raise ValueError("a record claims an impossible size")
    return int(length)


def read_header(stream: ExactReader) -> RecordHeader:
    """Read the header of the next record."""
    return _fields(memoryview(stream.read(read_length(stream))))


def packed_chunk(header: RecordHeader, data: bytes | memoryview, *, is_whole: bool = True) -> PackedChunk:
    """Return the chunk in a record."""
    (size,) = _LENGTH.unpack(header[b"size"])
    return PackedChunk(header[b"compression"].decode(), data, size, is_whole=is_whole)


def records_of(chunk: memoryview) -> Iterator[tuple[RecordHeader, memoryview]]:
    """Yield header and data of each record, without a copy of the data; at most `MAX_RECORDS`."""
    place = 0
    for _ in range(MAX_RECORDS):
        if place == len(chunk):
            return
        header, place = _part(chunk, place)
        data, place = _part(chunk, place)
        yield _fields(header), data
    raise ValueError("a chunk holds an impossible number of records")


def _part(data: memoryview, place: int) -> tuple[memoryview, int]:
    start = place + _LENGTH.size
    end = start + unpack_head(_LENGTH, data, place)[0]
    if end > len(data):
        raise EndOfFileError
    return data[start:end], end


def _fields(data: memoryview) -> RecordHeader:
    fields: dict[bytes, bytes] = {}
    place = 0
    while place < len(data):
        field, place = _part(data, place)
        name, _, value = bytes(field).partition(b"=")
        fields[name] = value
    return fields
