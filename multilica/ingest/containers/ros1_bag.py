# SPDX-License-Identifier: Apache-2.0
"""The reader of ROS 1 bags."""

import struct
from collections import Counter
from collections.abc import Collection, Iterator
from contextlib import closing
from functools import partial
from pathlib import Path

from multilica.ingest.containers.chunked import ChunkedRecording, ChunkPlace, PackedChunk
from multilica.ingest.containers.exact_reader import EndOfFileError, ExactReader
from multilica.ingest.containers.ros1_records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    MAGIC_BYTES,
    RecordHeader,
    connection_topic,
    messages_of,
    packed_chunk,
    read_header,
    read_length,
    records_of,
    time_ns,
)
from multilica.ingest.containers.unindexed import Part, UnindexedRecording
from multilica.ingest.damage import DamagedRecordingError, damage_named
from multilica.ingest.recording import RawMessage, Recording, Topic, joint_topics

_OFFSET = struct.Struct("<Q")
_COUNT = struct.Struct("<4sI")


def open_file(path: Path, where: str) -> Recording:
    """Open a ``.bag`` file by its index; without a valid index, read it from front to end."""
    stream = ExactReader(path)
    try:
        with damage_named(where):
            return _open_indexed(stream, where)
    except DamagedRecordingError:
        stream.close()
        return open_unindexed(path, where)


def open_unindexed(path: Path, where: str) -> UnindexedRecording:
    """Open a bag by reading it from the front up to the first damage."""
    return UnindexedRecording("ROS 1 bag without index", where, partial(_parts, path, where, {}))


def _open_indexed(stream: ExactReader, where: str) -> ChunkedRecording:
    topics: dict[bytes, Topic] = {}
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
            topics[header[b"conn"]] = connection_topic(header, memoryview(data))
        elif header[b"op"][0] == CHUNK_INFO:
            in_chunk = dict(_COUNT.iter_unpack(data))
            counts.update(in_chunk)
            chunks.append(
                ChunkPlace(
                    _OFFSET.unpack(header[b"chunk_pos"])[0],
                    time_ns(header[b"start_time"]),
                    time_ns(header[b"end_time"]),
                    frozenset(topics[number].name for number in in_chunk),
                )
            )
    if not chunks:
        raise ValueError("its index is empty")
    totals = joint_topics((topic, counts[number]) for number, topic in topics.items())
    return ChunkedRecording("ROS 1 bag", where, stream, totals, chunks, _read_chunk, partial(_split, topics, where))


def _read_chunk(stream: ExactReader, place: ChunkPlace) -> PackedChunk:
    stream.seek(place.offset)
    header = read_header(stream)
    if header[b"op"][0] != CHUNK:
        raise ValueError("its index points to something that is not a chunk")
    return packed_chunk(header, stream.view(read_length(stream)))


def _split(topics: dict[bytes, Topic], where: str, data: memoryview, wanted: Collection[str]) -> Iterator[RawMessage]:
    records = ((header, data) for header, data in records_of(data) if header[b"op"][0] != CONNECTION)
    return (message for message in messages_of(records, topics, where) if message.topic in wanted)


def _parts(path: Path, where: str, topics: dict[bytes, Topic], place: int) -> Iterator[Part]:
    """Yield the parts from a position on; `topics` are those of the connections so far."""
    has_index = False
    with closing(ExactReader(path)) as stream:
        stream.seek(max(place, MAGIC_BYTES))
        while stream.remaining:
            begin = stream.tell()
            header = read_header(stream)
            if not header:
                stream.skip_zeros(begin)
                continue
            size = read_length(stream)
            data = stream.view(min(size, stream.remaining))
            has_index = has_index or header[b"op"][0] == CHUNK_INFO
            yield stream.tell(), messages_of(_records(header, data, is_whole=len(data) == size), topics, where)
            if len(data) < size:
                raise EndOfFileError
        if not has_index:
            raise EndOfFileError


def _records(header: RecordHeader, data: memoryview, *, is_whole: bool) -> Iterator[tuple[RecordHeader, memoryview]]:
    if header[b"op"][0] == CHUNK:
        yield from records_of(packed_chunk(header, data, is_whole=is_whole).unpack())
    else:
        yield header, data
