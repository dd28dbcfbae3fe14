# SPDX-License-Identifier: Apache-2.0
"""The reader of MCAP files."""

from collections.abc import Collection, Iterator, Mapping
from contextlib import suppress
from functools import partial

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import ChunkIndex, Footer
from mcap.summary import Summary

from multilica.ingest.containers.chunked import ChunkedRecording, ChunkPlace, PackedChunk
from multilica.ingest.containers.exact_reader import ExactReader
from multilica.ingest.containers.mcap_records import (
    MAGIC,
    MESSAGE_HEAD,
    RECORD_HEAD,
    chunk_of,
    record_length,
    records_of,
    topic_of,
)
from multilica.ingest.containers.mcap_unindexed import open_unindexed
from multilica.ingest.damage import DamagedRecordingError, damage_named
from multilica.ingest.decompression import require_checksum
from multilica.ingest.recording import RawMessage, Recording, Topic, joint_topics
from multilica.ingest.remote.remote_file import SourceFile, path_on_disk

_FOOTER_BYTES = 20
_CRC_BYTES = 4


def open_file(path: SourceFile, where: str) -> Recording:
    """Open an MCAP file by its index; without a valid index, read it from front to end."""
    stream = ExactReader(path)
    summary = _summary(stream)
    if summary is None or summary.statistics is None or not summary.chunk_indexes:
        stream.close()
        return open_unindexed(path_on_disk(path, "an MCAP file without index"), where)
    topics = {number: topic_of(channel, summary.schemas) for number, channel in summary.channels.items()}
    counts = summary.statistics.channel_message_counts
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
    with suppress(DamagedRecordingError), damage_named("the index"):
        summary = make_reader(stream).get_summary()
        if summary is not None:
            _require_checksum(stream)
        return summary
    return None


def _require_checksum(stream: ExactReader) -> None:
    """Check the index against the checksum in the footer: a flipped bit would hide chunks."""
    end = stream.seek(0, 2)
    stream.seek(end - len(MAGIC) - _FOOTER_BYTES)
    footer = Footer.read(ReadDataStream(stream))
    stream.seek(footer.summary_start)
    covered = stream.read(end - len(MAGIC) - _CRC_BYTES - footer.summary_start)
    require_checksum(covered, footer.summary_crc)


def _place(index: ChunkIndex, topics: Mapping[int, Topic]) -> ChunkPlace:
    known = frozenset(topics[number].name for number in index.message_index_offsets if number in topics)
    # Without message indexes, only the chunk itself tells its topics.
    return ChunkPlace(
        index.chunk_start_offset,
        index.message_start_time,
        index.message_end_time,
        known if index.message_index_offsets else None,
    )


def _read_chunk(stream: ExactReader, place: ChunkPlace) -> PackedChunk:
    stream.seek(place.offset)
    opcode, length = record_length(stream.read(RECORD_HEAD.size))
    if opcode != Opcode.CHUNK:
        raise ValueError("its index points to something that is not a chunk")
    return chunk_of(stream.view(length))


def _split(topics: Mapping[int, Topic], where: str, data: memoryview, wanted: Collection[str]) -> Iterator[RawMessage]:
    chosen = {number: topic for number, topic in topics.items() if topic.name in wanted}
    for opcode, record in records_of(data):
        if opcode == Opcode.MESSAGE:
            channel, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(record)
            if channel in chosen:
                yield chosen[channel].message(log_time_ns, record[MESSAGE_HEAD.size :], where)
