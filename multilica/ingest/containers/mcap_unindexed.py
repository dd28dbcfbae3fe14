# SPDX-License-Identifier: Apache-2.0
"""The reader of MCAP files without index.

`mcap` can only iterate such a file. Most of them were cut off when the recorder died, and have message indexes behind
their chunks. Reading 10 frames of such a file of 280 MB takes 0.2 s of processor time and 120 MB with `survey`, which
reads the indexes, and 0.9 s and 240 MB by iterating first; the difference grows with the file.
"""

from collections.abc import Iterator
from contextlib import closing
from functools import partial
from io import SEEK_END
from pathlib import Path

import numpy as np
from isal.isal_zlib import crc32 as crc32_of
from mcap.opcode import Opcode

from multilica.ingest.containers.exact_reader import EndOfFileError, ExactReader
from multilica.ingest.containers.mcap_records import (
    MAGIC,
    MESSAGE_HEAD,
    RECORD_HEAD,
    KnownChannels,
    chunk_claims,
    record_length,
    require_opcode,
)
from multilica.ingest.containers.unindexed import Part, Survey, UnindexedRecording
from multilica.ingest.damage import DamagedRecordingError, damage_named, reason_of
from multilica.ingest.recording import Span

_READ = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.DATA_END)
_BLOCK_BYTES = 1 << 20
_BOUNDED = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
_MAX_CHECKED_BYTES = 256 << 20
_CHUNK_HEAD_BYTES = 64
_INDEX_HEAD_BYTES = 6


def open_unindexed(path: Path, where: str) -> UnindexedRecording:
    """Open an MCAP file by reading it from the front up to the first damage."""
    known = KnownChannels(where)
    return UnindexedRecording("MCAP without index", where, partial(_parts, path, known), partial(survey, path, known))


def _parts(path: Path, known: KnownChannels, place: int) -> Iterator[Part]:
    """Yield the parts from a position on; `known` are the channels so far."""
    with closing(ExactReader(path)) as stream:
        for opcode, record in _records(stream, place):
            yield stream.tell(), known.messages_of(opcode, record)


def _records(stream: ExactReader, place: int) -> Iterator[tuple[int, memoryview]]:
    """Yield the records with messages, and the beginning of a chunk that was cut off.

    Attachments and the like are skipped, whatever their size. The checksum of the data section is only checked when
    reading starts at the beginning of the file.
    """
    head = stream.read(len(MAGIC))
    if head != MAGIC:
        raise ValueError("it does not begin like an MCAP file")
    stream.seek(max(place, len(MAGIC)))
    crc32 = crc32_of(head)
    opcode = 0
    while opcode != Opcode.FOOTER:
        before = crc32
        head = stream.read(RECORD_HEAD.size)
        opcode, length = RECORD_HEAD.unpack(head)
        if opcode == 0:
            stream.skip_zeros(stream.tell() - RECORD_HEAD.size)
            place = stream.tell()
            continue
        require_opcode(opcode, length)
        crc32 = crc32_of(head, crc32)
        if opcode not in _READ and (place or length > _MAX_CHECKED_BYTES):
            # Its bytes, which may be a hole of a sparse file, only count for the checksum.
            if length > stream.remaining:
                raise EndOfFileError
            place = max(place, 1)
            stream.seek(stream.tell() + length)
            continue
        if opcode not in _READ:
            for offset in range(0, length, _BLOCK_BYTES):
                crc32 = crc32_of(stream.read(min(_BLOCK_BYTES, length - offset)), crc32)
            continue
        record_length(head)  # fails if it is too large
        if opcode == Opcode.CHUNK and length > stream.remaining:
            yield opcode, memoryview(stream.read(stream.remaining))
            raise EndOfFileError
        record = stream.view(length) if opcode == Opcode.CHUNK else memoryview(stream.read(length))
        crc32 = crc32_of(record, crc32)
        if opcode == Opcode.DATA_END and place == 0 and int.from_bytes(record, "little") not in (0, before):
            raise ValueError("a checksum does not match its data")
        yield opcode, record
    stream.read(len(MAGIC))


def survey(path: Path, known: KnownChannels) -> Survey | None:
    """Count messages by the message indexes behind the chunks; None if they are missing or make no sense."""
    found = Survey()
    stream = ExactReader(path)
    try:
        if stream.read(len(MAGIC)) != MAGIC:
            return None
        while _add_next(stream, found, known):
            found.mark(stream.tell())
    except EndOfFileError as error:
        found.damage = reason_of(error)
    except DamagedRecordingError as error:
        found.damage = error.reason
    except Exception:  # noqa: BLE001 - reading the messages meets it again and names it
        return None
    finally:
        stream.close()
    return found if found.counts else None


def _add_next(stream: ExactReader, found: Survey, known: KnownChannels) -> bool:
    """Add the next record; False if no messages follow."""
    opcode, length = _next_head(stream)
    end = stream.tell() + length
    if opcode == Opcode.CHUNK:
        _add_chunk(stream, end, found, known)
        return True
    if length > stream.remaining:
        raise EndOfFileError
    if opcode == Opcode.MESSAGE:
        channel, _, log_time_ns, _ = MESSAGE_HEAD.unpack(stream.read(MESSAGE_HEAD.size))
        found.add(known.topics[channel], 1, (log_time_ns, log_time_ns), length)
    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        known.learn(opcode, memoryview(stream.read(length)))
    stream.seek(end)
    return opcode not in (Opcode.DATA_END, Opcode.FOOTER)


def _next_head(stream: ExactReader) -> tuple[int, int]:
    head = stream.read(RECORD_HEAD.size)
    opcode, length = RECORD_HEAD.unpack(head)
    if opcode == 0:
        stream.skip_zeros(stream.tell() - RECORD_HEAD.size)
        return _next_head(stream)
    require_opcode(opcode, length)
    return record_length(head) if opcode in _BOUNDED else (opcode, length)


def _add_chunk(stream: ExactReader, end: int, found: Survey, known: KnownChannels) -> None:
    start, read_end = stream.tell(), min(end, stream.tell() + stream.remaining)
    span, unpacked_bytes = chunk_claims(stream.read(min(_CHUNK_HEAD_BYTES, read_end - start)))
    found.latest_ns = max(found.latest_ns, span[1])
    stream.seek(read_end)
    indexed = _message_indexes(stream, span)
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
        times = np.frombuffer(record, "<u8", offset=_INDEX_HEAD_BYTES)[::2]
        if len(times):
            first, last = int(times.min()), int(times.max())
            if not span[0] <= first <= last <= span[1]:
                raise ValueError("message indexes contradict the span of their chunk")
            indexed[int.from_bytes(record[:2], "little")] = len(times), (first, last)
    return indexed
