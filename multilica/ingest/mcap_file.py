# SPDX-License-Identifier: Apache-2.0
"""MCAP files."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from functools import partial
from typing import IO, cast

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import ChunkIndex, Footer
from mcap.summary import Summary

from multilica.ingest.chunked import ChunkedRecording, ChunkPlace, PackedChunk
from multilica.ingest.damage import DamagedRecordingError, damage_named
from multilica.ingest.downloaded import open_on_disk
from multilica.ingest.mcap_records import (
    MESSAGE_HEAD,
    RECORD_HEAD,
    Stream,
    chunk_of,
    record_length,
    records_of,
    stream_of,
    topics_of,
)
from multilica.ingest.mcap_scan import open_unindexed
from multilica.ingest.recording import Message, Recording
from multilica.ingest.remote_file import SourceFile
from multilica.ingest.unpacking import require_checksum
from multilica.ingest.whole_reads import WholeReads

__all__ = ["open_file", "open_indexed"]

_FOOTER_BYTES = 20
_MAGIC_BYTES = 8
_CRC_BYTES = 4


def open_file(path: SourceFile) -> Recording:
    """Open an MCAP file: by its index, or from front to end where that is missing.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """
    stream = WholeReads.of_file(path)
    indexed = open_indexed(stream, str(path))
    if indexed is None:
        stream.close()
        return open_on_disk(path, "an MCAP file without index", open_unindexed)
    return indexed


def open_indexed(stream: WholeReads, where: str) -> ChunkedRecording | None:
    """Open a stream by its index; None if it has none that can be used.

    Args:
        stream: the file; the recording closes it.
        where: the file, for messages.
    """
    summary = _summary(stream)
    if summary is None or summary.statistics is None or not summary.chunk_indexes:
        return None
    streams = {number: stream_of(channel, summary.schemas, where) for number, channel in summary.channels.items()}
    return ChunkedRecording(
        "MCAP",
        where,
        stream,
        topics_of(streams, summary.statistics.channel_message_counts),
        [_place(index, streams) for index in summary.chunk_indexes],
        _read_chunk,
        partial(_split, streams),
    )


def _summary(stream: WholeReads) -> Summary | None:
    try:
        with damage_named("the index"):
            summary = make_reader(cast(IO[bytes], stream)).get_summary()
            if summary is not None:
                _require_whole(stream)
            return summary
    except DamagedRecordingError:
        return None


def _require_whole(stream: WholeReads) -> None:
    """Check the index against the checksum in the footer; a flipped bit in it would hide chunks."""
    end = stream.seek(0, 2)
    stream.seek(end - _MAGIC_BYTES - _FOOTER_BYTES)
    footer = Footer.read(ReadDataStream(cast(IO[bytes], stream)))
    stream.seek(footer.summary_start)
    covered = stream.read(end - _MAGIC_BYTES - _CRC_BYTES - footer.summary_start)
    require_checksum(covered, footer.summary_crc)


def _place(index: ChunkIndex, streams: Mapping[int, Stream]) -> ChunkPlace:
    known = frozenset(streams[number].topic for number in index.message_index_offsets if number in streams)
    # Without message indexes, only the chunk itself tells what it holds.
    topics = known if index.message_index_offsets else None
    return ChunkPlace(index.chunk_start_offset, index.message_start_time, index.message_end_time, topics)


def _read_chunk(stream: WholeReads, place: ChunkPlace) -> PackedChunk:
    stream.seek(place.offset)
    opcode, length = record_length(stream.read(RECORD_HEAD.size))
    if opcode != Opcode.CHUNK:
        raise ValueError("its index points to something that is no chunk")
    return chunk_of(stream.view(length))


def _split(streams: Mapping[int, Stream], data: memoryview, topics: Collection[str]) -> Iterator[Message]:
    chosen = {number: stream for number, stream in streams.items() if stream.topic in topics}
    for opcode, record in records_of(data):
        if opcode == Opcode.MESSAGE:
            channel, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(record)
            if channel in chosen:
                yield chosen[channel].message(record, log_time_ns)
