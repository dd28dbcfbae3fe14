# SPDX-License-Identifier: Apache-2.0
"""The reader of ROS 1 bags.

Functions of records raise `EndOfFileError` if data end too early, and ValueError, with a clause as its text, if they
are wrong.
"""

import struct
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import TypeAlias

from multilica.ingest.containers.chunked import (
    ChunkedRecording,
    ChunkPlace,
    EndOfFileError,
    ExactReader,
    PackedChunk,
    unpack_head,
)
from multilica.ingest.containers.unindexed import Part, UnindexedRecording
from multilica.ingest.decompression import MAX_RECORDS, MAX_UNPACKED_BYTES
from multilica.ingest.recording import (
    DamagedRecordingError,
    RawMessage,
    Recording,
    Topic,
    damage_named,
    joint_topics,
    normal_type,
)

_OFFSET = struct.Struct("<Q")

_MAGIC_BYTES = len(b"#ROSBAG V2.0\n")
_CHUNK, _CHUNK_INFO, _CONNECTION = 5, 6, 7
_MESSAGE = 2

_RecordHeader: TypeAlias = Mapping[bytes, bytes]

_LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")


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
    stream.seek(_MAGIC_BYTES)
    (index_pos,) = _OFFSET.unpack(_read_header(stream)[b"index_pos"])
    if index_pos <= _MAGIC_BYTES:
        raise ValueError("it has no index")
    stream.seek(index_pos)
    while stream.remaining:
        header = _read_header(stream)
        data = stream.read(_read_length(stream))
        if header[b"op"][0] == _CONNECTION:
            topics[header[b"conn"]] = _connection_topic(header, memoryview(data))
        elif header[b"op"][0] == _CHUNK_INFO:
            in_chunk = dict(struct.Struct("<4sI").iter_unpack(data))
            counts.update(in_chunk)
            chunks.append(
                ChunkPlace(
                    _OFFSET.unpack(header[b"chunk_pos"])[0],
                    _time_ns(header[b"start_time"]),
                    _time_ns(header[b"end_time"]),
                    frozenset(topics[number].name for number in in_chunk),
                )
            )
    if not chunks:
        raise ValueError("its index is empty")
    totals = joint_topics((topic, counts[number]) for number, topic in topics.items())
    return ChunkedRecording("ROS 1 bag", where, stream, totals, chunks, _read_chunk, partial(_split, topics, where))


def _read_chunk(stream: ExactReader, place: ChunkPlace) -> PackedChunk:
    stream.seek(place.offset)
    header = _read_header(stream)
    if header[b"op"][0] != _CHUNK:
        raise ValueError("its index points to something that is not a chunk")
    return _packed_chunk(header, stream.view(_read_length(stream)))


def _split(topics: dict[bytes, Topic], where: str, data: memoryview, wanted: Collection[str]) -> Iterator[RawMessage]:
    records = ((header, data) for header, data in _records_of(data) if header[b"op"][0] != _CONNECTION)
    return (message for message in _messages_of(records, topics, where) if message.topic in wanted)


def _parts(path: Path, where: str, topics: dict[bytes, Topic], place: int) -> Iterator[Part]:
    """Yield the parts from a position on; `topics` are those of the connections so far."""
    has_index = False
    with closing(ExactReader(path)) as stream:
        stream.seek(max(place, _MAGIC_BYTES))
        while stream.remaining:
            begin = stream.tell()
            header = _read_header(stream)
            if not header:
                stream.skip_zeros(begin)
                continue
            size = _read_length(stream)
            data = stream.view(min(size, stream.remaining))
            has_index = has_index or header[b"op"][0] == _CHUNK_INFO
            yield stream.tell(), _messages_of(_records(header, data, is_whole=len(data) == size), topics, where)
            if len(data) < size:
                raise EndOfFileError
        if not has_index:
            raise EndOfFileError


def _records(header: _RecordHeader, data: memoryview, *, is_whole: bool) -> Iterator[tuple[_RecordHeader, memoryview]]:
    if header[b"op"][0] == _CHUNK:
        yield from _records_of(_packed_chunk(header, data, is_whole=is_whole).unpack())
    else:
        yield header, data


def _connection_topic(header: _RecordHeader, data: memoryview) -> Topic:
    """Return the topic in a connection record, without a count."""
    return Topic(header[b"topic"].decode(), normal_type(_fields(data)[b"type"].decode()), "ros1")


def _messages_of(
    records: Iterable[tuple[_RecordHeader, memoryview]], topics: dict[bytes, Topic], where: str
) -> Iterator[RawMessage]:
    """Yield the messages in records; add connections in the records to `topics`."""
    for header, data in records:
        if header[b"op"][0] == _CONNECTION:
            topics[header[b"conn"]] = _connection_topic(header, data)
        elif header[b"op"][0] == _MESSAGE:
            yield topics[header[b"conn"]].message(_time_ns(header[b"time"]), data, where)


def _time_ns(field: bytes | memoryview) -> int:
    """Return nanoseconds since the epoch."""
    seconds, nanoseconds = _TIME.unpack(field)
    return int(seconds) * 10**9 + int(nanoseconds)


def _read_length(stream: ExactReader) -> int:
    """Read the length in bytes of what follows."""
    (length,) = _LENGTH.unpack(stream.read(_LENGTH.size))
    if length > MAX_UNPACKED_BYTES:
        raise ValueError("a record claims an impossible size")
    return int(length)


def _read_header(stream: ExactReader) -> _RecordHeader:
    """Read the header of the next record."""
    return _fields(memoryview(stream.read(_read_length(stream))))


def _packed_chunk(header: _RecordHeader, data: bytes | memoryview, *, is_whole: bool = True) -> PackedChunk:
    """Return the chunk in a record."""
    (size,) = _LENGTH.unpack(header[b"size"])
    return PackedChunk(header[b"compression"].decode(), data, size, is_whole=is_whole)


def _records_of(chunk: memoryview) -> Iterator[tuple[_RecordHeader, memoryview]]:
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


def _fields(data: memoryview) -> _RecordHeader:
    fields: dict[bytes, bytes] = {}
    place = 0
    while place < len(data):
        field, place = _part(data, place)
        name, _, value = bytes(field).partition(b"=")
        fields[name] = value
    return fields
