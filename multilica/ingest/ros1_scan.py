# SPDX-License-Identifier: Apache-2.0
"""ROS 1 bags from front to end, for those without an index."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
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
from multilica.ingest.unindexed import Part, UnindexedRecording
from multilica.ingest.whole_reads import EndOfFileError, WholeReads

__all__ = ["open_unindexed"]


def open_unindexed(path: Path) -> UnindexedRecording:
    """Open a bag by reading it from the front for as long as it makes sense.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """
    return UnindexedRecording("ROS 1 bag without index", partial(_parts, path, {}))


def _parts(path: Path, connections: dict[bytes, Connection], place: int) -> Iterator[Part]:
    """From a place on; `connections` are those that were met so far."""
    closed = False
    stream, memory = WholeReads.of_file(path), ReusedMemory()
    try:
        with damage_named(str(path)):
            stream.seek(max(place, MAGIC_BYTES))
            while stream.remaining:
                header = read_header(stream)
                size = read_length(stream)
                data = stream.read(min(size, stream.remaining))
                closed = closed or header[b"op"][0] == CHUNK_INFO
                yield stream.tell(), _messages(path, connections, header, data, size, memory)
                if len(data) < size:
                    raise EndOfFileError
            if not closed:
                raise EndOfFileError
    finally:
        stream.close()


def _messages(
    path: Path, connections: dict[bytes, Connection], header: Header, data: bytes, size: int, memory: ReusedMemory
) -> Iterator[Message]:
    with damage_named(str(path)):
        records: Iterable[tuple[Header, memoryview]] = [(header, memoryview(data))]
        if header[b"op"][0] == CHUNK:
            records = records_of(packed_chunk(header, data, is_whole=len(data) == size).unpack(memory))
        for inner, content in records:
            operation = inner[b"op"][0]
            if operation == CONNECTION:
                connections[inner[b"conn"]] = connection_of(inner, content, path)
            elif operation == MESSAGE:
                yield connections[inner[b"conn"]].message(inner, content)
