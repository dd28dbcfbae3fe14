# SPDX-License-Identifier: Apache-2.0
"""Records of ROS 1 bags in the terms of `recording`."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

from multilica.ingest.chunked import PackedChunk
from multilica.ingest.recording import Message, normal_type
from multilica.ingest.unpacking import MAX_RECORDS, MAX_UNPACKED_BYTES
from multilica.ingest.whole_reads import EndOfFileError, WholeReads

__all__ = [
    "CHUNK",
    "CHUNK_INFO",
    "CONNECTION",
    "MAGIC_BYTES",
    "MESSAGE",
    "Connection",
    "Header",
    "connection_of",
    "packed_chunk",
    "read_header",
    "read_length",
    "records_of",
    "time_ns",
]

MAGIC_BYTES = len(b"#ROSBAG V2.0\n")
MESSAGE, CHUNK, CHUNK_INFO, CONNECTION = 2, 5, 6, 7

Header: TypeAlias = Mapping[bytes, bytes]

_LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")


@dataclass(frozen=True, slots=True)
class Connection:
    """What a connection record says about each of its messages."""

    topic: str
    message_type: str
    origin: str

    def message(self, header: Header, data: bytes | memoryview) -> Message:
        """The message in a record, its bytes untouched."""
        return Message(self.topic, self.message_type, "ros1", time_ns(header[b"time"]), data, self.origin)


def connection_of(header: Header, data: memoryview, path: Path) -> Connection:
    """The connection that a record describes."""
    topic = header[b"topic"].decode()
    return Connection(topic, normal_type(_fields(data)[b"type"].decode()), f"In {path}, a scan of '{topic}'")


def time_ns(field: bytes | memoryview) -> int:
    """Nanoseconds since the epoch."""
    seconds, nanoseconds = _TIME.unpack(field)
    return int(seconds) * 10**9 + int(nanoseconds)


def read_length(stream: WholeReads) -> int:
    """The length of what follows.

    Raises:
        ValueError: larger than anything that is sane; the text is a clause.
    """
    (length,) = _LENGTH.unpack(stream.read(_LENGTH.size))
    if length > MAX_UNPACKED_BYTES:
        raise ValueError("a record claims an impossible size")
    return int(length)


def read_header(stream: WholeReads) -> Header:
    """The header of the record that comes next."""
    return _fields(memoryview(stream.read(read_length(stream))))


def packed_chunk(header: Header, data: bytes | memoryview, *, is_whole: bool = True) -> PackedChunk:
    """The chunk that a record holds."""
    (size,) = _LENGTH.unpack(header[b"size"])
    return PackedChunk(header[b"compression"].decode(), data, size, is_whole=is_whole)


def records_of(chunk: memoryview) -> Iterator[tuple[Header, memoryview]]:
    """Header and data of each record, without a copy of the data.

    Raises:
        EndOfFileError: a record is longer than what is there.
        ValueError: there are more than a chunk can sanely hold; the text is a clause.
    """
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
    if start > len(data):
        raise EndOfFileError
    end = start + _LENGTH.unpack_from(data, place)[0]
    if end > len(data):
        raise EndOfFileError
    return data[start:end], end


def _fields(data: memoryview) -> Header:
    fields: dict[bytes, bytes] = {}
    place = 0
    while place < len(data):
        field, place = _part(data, place)
        name, _, value = bytes(field).partition(b"=")
        fields[name] = value
    return fields
