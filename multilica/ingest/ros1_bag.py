# SPDX-License-Identifier: Apache-2.0
"""ROS 1 bags."""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from functools import partial
from pathlib import Path

from multilica.ingest.chunked import ChunkedRecording, ChunkPlace, PackedChunk
from multilica.ingest.damage import DamagedRecordingError, damage_named
from multilica.ingest.recording import Message, Recording, Topic
from multilica.ingest.ros1_records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    MAGIC_BYTES,
    MESSAGE,
    Connection,
    connection_of,
    packed_chunk,
    read_header,
    read_length,
    records_of,
    time_ns,
)
from multilica.ingest.ros1_scan import open_unindexed
from multilica.ingest.whole_reads import WholeReads

__all__ = ["open_file"]

_OFFSET = struct.Struct("<Q")
_COUNT = struct.Struct("<4sI")


def open_file(path: Path) -> Recording:
    """Open a ``.bag`` file: by its index, or from front to end where that is missing.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """
    stream = WholeReads.of_file(path)
    try:
        with damage_named(str(path)):
            return _open_indexed(stream, path)
    except DamagedRecordingError:
        stream.close()
        return open_unindexed(path)


def _open_indexed(stream: WholeReads, path: Path) -> ChunkedRecording:
    connections: dict[bytes, Connection] = {}
    counts: Counter[bytes] = Counter()
    chunks: list[ChunkPlace] = []
    stream.seek(MAGIC_BYTES)
    (index_pos,) = _OFFSET.unpack(read_header(stream)[b"index_pos"])
    if index_pos <= MAGIC_BYTES:
        raise ValueError("it has no index")
    stream.seek(index_pos)
    while stream.remaining:
        header = read_header(stream)
        data = stream.read(read_length(stream))
        if header[b"op"][0] == CONNECTION:
            connections[header[b"conn"]] = connection_of(header, memoryview(data), path)
        elif header[b"op"][0] == CHUNK_INFO:
            held = dict(_COUNT.iter_unpack(data))
            counts.update(held)
            chunks.append(
                ChunkPlace(
                    _OFFSET.unpack(header[b"chunk_pos"])[0],
                    time_ns(header[b"start_time"]),
                    time_ns(header[b"end_time"]),
                    frozenset(connections[number].topic for number in held),
                )
            )
    if not chunks:
        raise ValueError("its index is empty")
    topics = _topics(connections, counts)
    return ChunkedRecording("ROS 1 bag", str(path), stream, topics, chunks, _read_chunk, partial(_split, connections))


def _topics(connections: Mapping[bytes, Connection], counts: Mapping[bytes, int]) -> tuple[Topic, ...]:
    totals: Counter[tuple[str, str]] = Counter()
    for number, connection in connections.items():
        totals[connection.topic, connection.message_type] += counts.get(number, 0)
    return tuple(Topic(name, message_type, "ros1", count) for (name, message_type), count in sorted(totals.items()))


def _read_chunk(stream: WholeReads, place: ChunkPlace) -> PackedChunk:
    stream.seek(place.offset)
    header = read_header(stream)
    if header[b"op"][0] != CHUNK:
        raise ValueError("its index points to something that is no chunk")
    return packed_chunk(header, stream.view(read_length(stream)))


def _split(connections: Mapping[bytes, Connection], data: memoryview, topics: Collection[str]) -> Iterator[Message]:
    for header, content in records_of(data):
        if header[b"op"][0] == MESSAGE:
            connection = connections[header[b"conn"]]
            if connection.topic in topics:
                yield connection.message(header, content)
