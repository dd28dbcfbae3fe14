# SPDX-License-Identifier: Apache-2.0
"""ROS 1 bags from front to end, for those without an index."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from multilica.ingest.damage import damage_named
from multilica.ingest.recording import Message
from multilica.ingest.reused_memory import ReusedMemory
from multilica.ingest.ros1_records import (
    CHUNK,
    CHUNK_INFO,
    CONNECTION,
    MAGIC_BYTES,
    MESSAGE,
    Connection,
    Header,
    connection_of,
    packed_chunk,
    read_header,
    read_length,
    records_of,
)
from multilica.ingest.unindexed import UnindexedRecording
from multilica.ingest.whole_reads import EndOfFileError, WholeReads

__all__ = ["open_unindexed"]


def open_unindexed(path: Path) -> UnindexedRecording:
    """Open a bag by reading it from the front for as long as it makes sense.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """
    return UnindexedRecording("ROS 1 bag without index", partial(_messages, path))


def _messages(path: Path) -> Iterator[Message]:
    connections: dict[bytes, Connection] = {}
    with damage_named(str(path)):
        for header, data in _all_records(path):
            operation = header[b"op"][0]
            if operation == CONNECTION:
                connections[header[b"conn"]] = connection_of(header, data, path)
            elif operation == MESSAGE:
                yield connections[header[b"conn"]].message(header, data)


def _all_records(path: Path) -> Iterator[tuple[Header, memoryview]]:
    closed = False
    stream, memory = WholeReads.of_file(path), ReusedMemory()
    try:
        stream.seek(MAGIC_BYTES)
        while stream.remaining:
            header = read_header(stream)
            size = read_length(stream)
            data = stream.read(min(size, stream.remaining))
            closed = closed or header[b"op"][0] == CHUNK_INFO
            if header[b"op"][0] == CHUNK:
                yield from records_of(packed_chunk(header, data, is_whole=len(data) == size).unpack(memory))
            else:
                yield header, memoryview(data)
            if len(data) < size:
                raise EndOfFileError
    finally:
        stream.close()
    if not closed:
        raise EndOfFileError
