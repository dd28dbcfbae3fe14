# SPDX-License-Identifier: Apache-2.0
"""ROS 1 bags without an index, as a recorder that died leaves them."""

from __future__ import annotations

import bz2
import struct
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import TypeAlias

import lz4.frame

from multilica.ingest.damage import DamagedRecordingError, damage_named
from multilica.ingest.recording import Message, Recording, Span, Topic, joint_span, normal_type
from multilica.ingest.whole_reads import EndOfFileError, WholeReads

__all__ = ["open_unindexed"]

_MAGIC_BYTES = len(b"#ROSBAG V2.0\n")
_MESSAGE, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 5, 6, 7

Header: TypeAlias = Mapping[bytes, bytes]


def open_unindexed(path: Path) -> Recording:
    """Open a bag by reading it from the front for as long as it makes sense.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """
    counts: dict[tuple[str, str], int] = {}
    spans: dict[str, Span] = {}
    damage = ""
    try:
        for message in _messages(path):
            key = (message.topic, message.message_type)
            counts[key] = counts.get(key, 0) + 1
            first, last = spans.get(message.topic, (message.log_time_ns, message.log_time_ns))
            spans[message.topic] = min(first, message.log_time_ns), max(last, message.log_time_ns)
    except DamagedRecordingError as error:
        if not counts:
            raise
        damage = error.reason
    topics = tuple(Topic(name, kind, "ros1", count) for (name, kind), count in sorted(counts.items()))
    return UnindexedRos1Bag(path, topics, spans, damage)


class UnindexedRos1Bag:
    """A bag that is read in the order of writing."""

    format = "ROS 1 bag without index"

    def __init__(self, path: Path, topics: tuple[Topic, ...], spans: Mapping[str, Span], damage: str) -> None:
        self.topics = topics
        self.damage = damage
        self._path = path
        self._spans = spans

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Known since the file was opened."""
        return joint_span(self._spans, topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Iterator[Message]:
        """In the order of writing."""
        for message in _messages(self._path):
            if message.topic in topics and message.log_time_ns >= start_ns:
                yield message

    def close(self) -> None:
        """Nothing stays open."""


def _messages(path: Path) -> Iterator[Message]:
    connections: dict[bytes, tuple[str, str]] = {}
    with damage_named(str(path)):
        for header, data in _all_records(path):
            operation = header[b"op"][0]
            if operation == _CONNECTION:
                message_type = _header(data)[b"type"].decode()
                connections[header[b"conn"]] = header[b"topic"].decode(), normal_type(message_type)
            elif operation == _MESSAGE:
                topic, message_type = connections[header[b"conn"]]
                seconds, nanoseconds = struct.unpack("<II", header[b"time"])
                log_time_ns = seconds * 10**9 + nanoseconds
                yield Message(topic, message_type, "ros1", log_time_ns, data, f"In {path}, a scan of '{topic}'")


def _all_records(path: Path) -> Iterator[tuple[Header, bytes]]:
    closed = False
    stream = WholeReads.of_file(path)
    try:
        stream.seek(_MAGIC_BYTES)
        while stream.remaining:
            header = _header(stream.read(_length(stream)))
            size = _length(stream)
            data = stream.read(min(size, stream.remaining))
            closed = closed or header[b"op"][0] == _CHUNK_INFO
            if header[b"op"][0] == _CHUNK:
                yield from _chunk_records(_unpacked(header, data))
            else:
                yield header, data
            if len(data) < size:
                raise EndOfFileError
    finally:
        stream.close()
    if not closed:
        raise EndOfFileError


def _chunk_records(chunk: bytes) -> Iterator[tuple[Header, bytes]]:
    stream = WholeReads.of_bytes(chunk)
    while stream.remaining:
        header = _header(stream.read(_length(stream)))
        yield header, stream.read(_length(stream))


def _unpacked(header: Header, data: bytes) -> bytes:
    (size,) = struct.unpack("<I", header[b"size"])
    compression = header[b"compression"]
    # The streaming decompressors give the beginning of a chunk that was cut off, and never more than it claims.
    if compression == b"bz2":
        return bz2.BZ2Decompressor().decompress(data, max_length=size)
    if compression == b"lz4":
        return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size))
    return data


def _header(data: bytes) -> Header:
    fields: dict[bytes, bytes] = {}
    stream = WholeReads.of_bytes(data)
    while stream.remaining:
        name, _, value = stream.read(_length(stream)).partition(b"=")
        fields[name] = value
    return fields


def _length(stream: WholeReads) -> int:
    (length,) = struct.unpack("<I", stream.read(4))
    return int(length)
