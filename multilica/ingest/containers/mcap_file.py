# SPDX-License-Identifier: Apache-2.0
"""The reader of MCAP files, by their index or from front to end.

`mcap` can only iterate a file without index. Most of them were cut off when the recorder died, and have message indexes
behind their chunks. Reading 10 frames of such a file of 280 MB takes 0.2 s of processor time and 120 MB with `_survey`,
which reads the indexes, and 0.9 s and 240 MB by iterating first; the difference grows with the file.
Functions of records raise `EndOfFileError` if data end too early, and ValueError, with a clause as its text, if they
are wrong.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing, suppress
from functools import partial
from io import SEEK_END, BytesIO
from pathlib import Path

import numpy as np
from isal.isal_zlib import crc32 as crc32_of
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, ChunkIndex, Footer, Metadata, Schema
from mcap.summary import Summary

from multilica.ingest.containers.chunked import (
    ChunkedRecording,
    ChunkPlace,
    EndOfFileError,
    ExactReader,
    PackedChunk,
    unpack_head,
)
from multilica.ingest.containers.unindexed import Part, Survey, UnindexedRecording
from multilica.ingest.decompression import MAX_RECORDS, MAX_UNPACKED_BYTES, require_checksum
from multilica.ingest.formats import FORMATS, named_format
from multilica.ingest.recording import (
    DamagedRecordingError,
    RawMessage,
    Recording,
    Span,
    Topic,
    damage_named,
    joint_topics,
    normal_type,
    reason_of,
)
from multilica.ingest.remote.remote_file import SourceFile, path_on_disk
from multilica.pointcloud2 import LIDAR_NAME_KEY

_FOOTER_BYTES, _CRC_BYTES = 20, 4
_READ = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END)
_BOUNDED = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
_MAX_CHECKED_BYTES = 256 << 20

(_MAGIC,) = FORMATS["mcap"].magic
_RECORD_HEAD = struct.Struct("<BQ")
"""Opcode, length of the content."""
_MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence, log time, publish time; the message's data follow."""
_CHUNK_HEAD = struct.Struct("<QQQII")
_LENGTH = struct.Struct("<Q")


def open_file(path: SourceFile, where: str) -> Recording:
    """Open an MCAP file by its index; without a valid index, read it from front to end."""
    stream = ExactReader(path)
    summary = _summary(stream)
    if summary is None or not _is_complete(summary):
        stream.close()
        return open_unindexed(path_on_disk(path, "an MCAP file without index"), where)
    topics = {number: _topic_of(channel, summary.schemas) for number, channel in summary.channels.items()}
    counts = summary.statistics.channel_message_counts if summary.statistics else {}
    return ChunkedRecording(
        "MCAP",
        where,
        stream,
        joint_topics((topic, counts.get(number, 0)) for number, topic in topics.items()),
        [_place(index, topics) for index in summary.chunk_indexes],
        _read_chunk,
        partial(_split, topics, where),
    )


def _summary(stream: ExactReader) -> Summary | None:
    """Return the index; None without one, or if its checksum shows a flipped bit, which would hide chunks."""
    with suppress(DamagedRecordingError), damage_named("the index"):
        summary = make_reader(stream).get_summary()
        if summary is not None:
            end = stream.seek(0, SEEK_END)
            stream.seek(end - len(_MAGIC) - _FOOTER_BYTES)
            footer = Footer.read(ReadDataStream(stream))
            stream.seek(footer.summary_start)
            covered = stream.read(end - len(_MAGIC) - _CRC_BYTES - footer.summary_start)
            require_checksum(covered, footer.summary_crc)
        return summary
    return None


def _is_complete(summary: Summary) -> bool:
    """Return whether the index tells all messages.

    It may leave out channels, schemas or counts, and messages may lie beside the chunks.
    """
    statistics = summary.statistics
    if statistics is None or not summary.chunk_indexes:
        return False
    counts = statistics.channel_message_counts
    in_chunks = [index.message_index_offsets.keys() for index in summary.chunk_indexes]
    named = {number for number, messages in counts.items() if messages}.union(*in_chunks)
    schemas = {channel.schema_id for channel in summary.channels.values()} - {0}
    outside = named.difference(*in_chunks) if all(in_chunks) else ()
    return (
        sum(counts.values()) == statistics.message_count
        and named <= summary.channels.keys()
        and schemas <= summary.schemas.keys()
        and not outside
    )


def _place(index: ChunkIndex, topics: Mapping[int, Topic]) -> ChunkPlace:
    offsets = index.message_index_offsets
    # Without message indexes, only the chunk itself tells its topics.
    known = frozenset(topics[number].name for number in offsets if number in topics) if offsets else None
    return ChunkPlace(index.chunk_start_offset, index.message_start_time, index.message_end_time, known)


def _read_chunk(stream: ExactReader, place: ChunkPlace) -> PackedChunk:
    stream.seek(place.offset)
    opcode, length = _record_length(stream.read(_RECORD_HEAD.size))
    if opcode != Opcode.CHUNK:
        raise ValueError("its index points to something that is not a chunk")
    return _chunk_of(stream.view(length))


def _split(topics: Mapping[int, Topic], where: str, data: memoryview, wanted: Collection[str]) -> Iterator[RawMessage]:
    chosen = {number: topic for number, topic in topics.items() if topic.name in wanted}
    for opcode, record in _records_of(data):
        if opcode == Opcode.MESSAGE:
            channel, _, log_time_ns, _ = _MESSAGE_HEAD.unpack_from(record)
            if channel in chosen:
                yield chosen[channel].message(log_time_ns, record[_MESSAGE_HEAD.size :], where)


def open_unindexed(path: Path, where: str) -> UnindexedRecording:
    """Open an MCAP file by reading it from the front up to the first damage."""
    known = _KnownChannels(where)
    return UnindexedRecording("MCAP without index", where, partial(_parts, path, known), partial(_survey, path, known))


def _parts(path: Path, known: _KnownChannels, place: int) -> Iterator[Part]:
    """Yield the parts from a position on; `known` are the channels so far."""
    with closing(ExactReader(path)) as stream:
        for opcode, record in _records(stream, place):
            yield stream.tell(), known.messages_of(opcode, record)


def _records(stream: ExactReader, place: int) -> Iterator[tuple[int, memoryview]]:
    """Yield the records with messages, and the beginning of a chunk that was cut off.

    Attachments and the like are skipped, whatever their size. The checksum of the data section is only checked when
    reading starts at the beginning of the file.
    """
    head = stream.read(len(_MAGIC))
    if head != _MAGIC:
        raise ValueError("it does not begin like an MCAP file")
    stream.seek(max(place, len(_MAGIC)))
    crc32 = crc32_of(head)
    opcode = 0
    while opcode != Opcode.FOOTER:
        before = crc32
        head = stream.read(_RECORD_HEAD.size)
        opcode, length = _RECORD_HEAD.unpack(head)
        if opcode == 0:
            stream.skip_zeros(stream.tell() - _RECORD_HEAD.size)
            place = stream.tell()
            continue
        _require_opcode(opcode, length)
        crc32 = crc32_of(head, crc32)
        if opcode not in _READ and (place or length > _MAX_CHECKED_BYTES):
            # Its bytes, which may be a hole of a sparse file, only count for the checksum.
            if length > stream.remaining:
                raise EndOfFileError
            place = max(place, 1)
            stream.seek(stream.tell() + length)
            continue
        if opcode not in _READ:
            for offset in range(0, length, 1 << 20):
                crc32 = crc32_of(stream.read(min(1 << 20, length - offset)), crc32)
            continue
        _record_length(head)  # fails if it is too large
        if opcode == Opcode.CHUNK and length > stream.remaining:
            yield opcode, memoryview(stream.read(stream.remaining))
            raise EndOfFileError
        record = stream.view(length) if opcode == Opcode.CHUNK else memoryview(stream.read(length))
        crc32 = crc32_of(record, crc32)
        if opcode == Opcode.DATA_END and place == 0 and int.from_bytes(record, "little") not in (0, before):
            raise ValueError("a checksum does not match its data")
        yield opcode, record
    stream.read(len(_MAGIC))


def _survey(path: Path, known: _KnownChannels) -> Survey | None:
    """Count messages by the message indexes behind the chunks; None if they are missing or make no sense."""
    found = Survey()
    with closing(ExactReader(path)) as stream:
        try:
            if stream.read(len(_MAGIC)) != _MAGIC:
                return None
            while _add_next(stream, found, known):
                found.mark(stream.tell())
        except EndOfFileError as error:
            found.damage = reason_of(error)
        except DamagedRecordingError as error:
            found.damage = error.reason
        except Exception:  # noqa: BLE001 - reading the messages meets it again and names it
            return None
    return found if found.counts else None


def _add_next(stream: ExactReader, found: Survey, known: _KnownChannels) -> bool:
    """Add the next record; False if no messages follow."""
    opcode, length = _next_head(stream)
    end = stream.tell() + length
    if opcode == Opcode.CHUNK:
        _add_chunk(stream, end, found, known)
        return True
    if length > stream.remaining:
        raise EndOfFileError
    if opcode == Opcode.MESSAGE:
        channel, _, log_time_ns, _ = _MESSAGE_HEAD.unpack(stream.read(_MESSAGE_HEAD.size))
        found.begin_part(log_time_ns)
        found.add(known.topics[channel], 1, (log_time_ns, log_time_ns), length)
    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        known.learn(opcode, memoryview(stream.read(length)))
    stream.seek(end)
    return opcode not in (Opcode.DATA_END, Opcode.FOOTER)


def _next_head(stream: ExactReader) -> tuple[int, int]:
    head = stream.read(_RECORD_HEAD.size)
    opcode, length = _RECORD_HEAD.unpack(head)
    if opcode == 0:
        stream.skip_zeros(stream.tell() - _RECORD_HEAD.size)
        return _next_head(stream)
    _require_opcode(opcode, length)
    return _record_length(head) if opcode in _BOUNDED else (opcode, length)


def _add_chunk(stream: ExactReader, end: int, found: Survey, known: _KnownChannels) -> None:
    start, read_end = stream.tell(), min(end, stream.tell() + stream.remaining)
    first_ns, last_ns, unpacked_bytes, _, _ = unpack_head(_CHUNK_HEAD, stream.read(min(64, read_end - start)))
    found.begin_part(first_ns)
    found.latest_ns = max(found.latest_ns, last_ns)
    stream.seek(read_end)
    indexed = _message_indexes(stream, (first_ns, last_ns))
    behind = stream.tell()
    if indexed and indexed.keys() <= known.topics.keys():
        for channel, (count, times) in indexed.items():
            found.add(known.topics[channel], count, times, unpacked_bytes)
            unpacked_bytes = 0
        return
    if not indexed and stream.remaining:
        raise ValueError("a chunk has no message indexes")
    stream.seek(start)
    with damage_named(known.where):
        for message in known.messages_of(Opcode.CHUNK, stream.view(read_end - start)):
            found.add_message(message, len(message.data))
    if read_end < end:
        raise EndOfFileError
    stream.seek(behind)


def _message_indexes(stream: ExactReader, span: Span) -> dict[int, tuple[int, Span]]:
    """Return number of messages and span per channel; empty if the file ends within the indexes."""
    indexed: dict[int, tuple[int, Span]] = {}
    while stream.remaining:
        place = stream.tell()
        try:
            opcode, length = _next_head(stream)
            record = stream.read(length) if opcode == Opcode.MESSAGE_INDEX else b""
        except EndOfFileError:
            stream.seek(0, SEEK_END)
            return {}
        if opcode != Opcode.MESSAGE_INDEX:
            stream.seek(place)
            break
        times = np.frombuffer(record, "<u8", offset=6)[::2]
        if len(times):
            first, last = int(times.min()), int(times.max())
            if not span[0] <= first <= last <= span[1]:
                raise ValueError("message indexes contradict the span of their chunk")
            indexed[int.from_bytes(record[:2], "little")] = len(times), (first, last)
    return indexed


def _records_of(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield opcode and content of each record, without a copy; at most `MAX_RECORDS`."""
    place = 0
    for _ in range(MAX_RECORDS):
        if place == len(data):
            return
        opcode, length = unpack_head(_RECORD_HEAD, data, place)
        place += _RECORD_HEAD.size
        _require_opcode(opcode, length)
        if length > len(data) - place or (opcode == Opcode.MESSAGE and length < _MESSAGE_HEAD.size):
            raise EndOfFileError
        yield opcode, data[place : place + length]
        place += length
    raise ValueError("a chunk holds an impossible number of records")


def _require_opcode(opcode: int, length: int) -> None:
    """Raise ValueError for what no writer writes: zeros, and records without content but the end of the file."""
    if opcode == 0 or (length == 0 and opcode != Opcode.FOOTER):
        raise ValueError("its records make no sense")


def _record_length(head: bytes) -> tuple[int, int]:
    """Return opcode and length in bytes of a record that is to be read into memory."""
    opcode, length = _RECORD_HEAD.unpack(head)
    if length > MAX_UNPACKED_BYTES + (1 << 10):
        raise ValueError("a record claims an impossible size")
    return opcode, length


def _chunk_of(record: memoryview) -> PackedChunk:
    """Return the chunk in a record; its beginning if the record was cut off."""
    _, _, size, crc32, name_bytes = unpack_head(_CHUNK_HEAD, record)
    end = _CHUNK_HEAD.size + name_bytes
    (length,) = unpack_head(_LENGTH, record, end)
    data = record[end + _LENGTH.size :]
    if length < len(data):
        raise EndOfFileError
    compression = str(record[_CHUNK_HEAD.size : end], "utf-8")
    return PackedChunk(compression, data, size, crc32, is_whole=length == len(data))


def _topic_of(channel: Channel, schemas: Mapping[int, Schema]) -> Topic:
    """Return the topic of a channel, without a count."""
    schema = schemas.get(channel.schema_id)
    message_type = "without schema" if schema is None else normal_type(schema.name)
    return Topic(channel.topic, message_type, channel.message_encoding, lidar=channel.metadata.get(LIDAR_NAME_KEY, ""))


class _KnownChannels:
    """The schemas and channels met so far on the way through a file."""

    def __init__(self, where: str) -> None:
        self.topics: dict[int, Topic] = {}
        self.where = where
        self._schemas: dict[int, Schema] = {}

    def messages_of(self, opcode: int, record: memoryview) -> Iterator[RawMessage]:
        """Yield the messages of a record or chunk; learn its schemas and channels."""
        records = _records_of(_chunk_of(record).unpack()) if opcode == Opcode.CHUNK else [(opcode, record)]
        for inner_opcode, inner in records:
            if inner_opcode == Opcode.MESSAGE:
                channel, _, log_time_ns, _ = _MESSAGE_HEAD.unpack_from(inner)
                yield self.topics[channel].message(log_time_ns, inner[_MESSAGE_HEAD.size :], self.where)
            else:
                self.learn(inner_opcode, inner)

    def learn(self, opcode: int, record: memoryview) -> None:
        """Remember a schema or a channel; ignore other records."""
        if opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(record)))
            self.topics[channel.id] = _topic_of(channel, self._schemas)
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(record)))
            self._schemas[schema.id] = schema


def mcap_metadata(path: SourceFile) -> Iterator[Metadata]:
    """Yield the records that the summary lists; none of every other file, and of a file that cannot be read."""
    with suppress(DamagedRecordingError), damage_named(str(path)):
        if named_format(path) is not FORMATS["mcap"] or not (path.exists() and path.is_file()):
            return
        with closing(ExactReader(path)) as stream:
            summary = make_reader(stream).get_summary()
            for index in (summary.metadata_indexes if summary else [])[:100]:
                if index.length <= 1 << 20:  # those of a vehicle or a snapshot take a few hundred bytes
                    stream.seek(index.offset + _RECORD_HEAD.size)
                    record = stream.read(index.length - _RECORD_HEAD.size)
                    yield Metadata.read(ReadDataStream(BytesIO(record)))
