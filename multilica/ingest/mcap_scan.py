# SPDX-License-Identifier: Apache-2.0
"""MCAP files from front to end, for those without an index."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path

from isal.isal_zlib import crc32 as crc32_of
from mcap.opcode import Opcode

from multilica.ingest.damage import damage_named
from multilica.ingest.mcap_records import (
    MAGIC,
    RECORD_HEAD,
    KnownChannels,
    record_length,
)
from multilica.ingest.mcap_survey import survey
from multilica.ingest.recording import Message
from multilica.ingest.unindexed import Part, UnindexedRecording
from multilica.ingest.whole_reads import EndOfFileError, WholeReads

__all__ = ["open_unindexed"]

_READ = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END)
_BLOCK_BYTES = 1 << 20


def open_unindexed(path: Path) -> UnindexedRecording:
    """Open an MCAP file by reading it from the front for as long as it makes sense.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """
    known = KnownChannels(str(path))
    return UnindexedRecording("MCAP without index", partial(_parts, path, known), partial(survey, path, known))


def _parts(path: Path, known: KnownChannels, place: int) -> Iterator[Part]:
    """From a place on; `known` are the channels that were met so far."""
    stream = WholeReads.of_file(path)
    try:
        with damage_named(known.where):
            for opcode, record in _records(stream, place):
                yield stream.tell(), _messages(known, opcode, record)
    finally:
        stream.close()


def _messages(known: KnownChannels, opcode: int, record: memoryview) -> Iterator[Message]:
    with damage_named(known.where):
        yield from known.messages_of(opcode, record)


def _records(stream: WholeReads, place: int) -> Iterator[tuple[int, memoryview]]:
    """What bears on messages; attachments and the like are passed over, whatever their size.

    Of a chunk that was cut off, what is there. The checksum over all is only looked at from the beginning of the file.
    """
    head = stream.read(len(MAGIC))
    if head != MAGIC:
        raise ValueError("it does not begin as an MCAP file does")
    stream.seek(max(place, len(MAGIC)))
    crc32 = crc32_of(head)
    opcode = 0
    while opcode != Opcode.FOOTER:
        before = crc32
        head = stream.read(RECORD_HEAD.size)
        opcode, length = RECORD_HEAD.unpack(head)
        crc32 = crc32_of(head, crc32)
        if opcode not in _READ:
            crc32 = _skip(stream, length, crc32)
            continue
        record_length(head)  # refuses what is too large
        if opcode == Opcode.CHUNK and length > stream.remaining:
            yield opcode, memoryview(stream.read(stream.remaining))
            raise EndOfFileError
        record = stream.view(length) if opcode == Opcode.CHUNK else memoryview(stream.read(length))
        crc32 = crc32_of(record, crc32)
        if opcode == Opcode.DATA_END and place == 0 and int.from_bytes(record, "little") not in (0, before):
            raise ValueError("a checksum does not match its data")
        yield opcode, record
    stream.read(len(MAGIC))


def _skip(stream: WholeReads, length: int, crc32: int) -> int:
    for offset in range(0, length, _BLOCK_BYTES):
        crc32 = crc32_of(stream.read(min(_BLOCK_BYTES, length - offset)), crc32)
    return crc32
