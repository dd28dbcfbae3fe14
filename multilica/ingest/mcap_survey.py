# SPDX-License-Identifier: Apache-2.0
"""What an MCAP file without a summary tells before its chunks are unpacked."""

from __future__ import annotations

from io import SEEK_END
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode

from multilica.ingest.damage import DamagedRecordingError, damage_named, reason_of
from multilica.ingest.mcap_records import (
    MAGIC,
    MESSAGE_HEAD,
    RECORD_HEAD,
    KnownChannels,
    chunk_claims,
    record_length,
)
from multilica.ingest.recording import Span
from multilica.ingest.unindexed import Survey
from multilica.ingest.whole_reads import EndOfFileError, WholeReads

__all__ = ["survey"]

_BOUNDED = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
_MOST_CLAIMS_BYTES = 64
_INDEX_HEAD_BYTES = 6

_Told = dict[int, tuple[int, Span]]
"""Channel -> number of its messages in a chunk, with the log times of the first and the last."""


class _NotToldError(Exception):
    """Only the messages themselves tell."""


def survey(path: Path, known: KnownChannels) -> Survey | None:
    """What the message indexes behind the chunks tell; None where there are none, or where anything makes no sense.

    Args:
        known: is told of every channel.
    """
    found = Survey()
    stream = WholeReads.of_file(path)
    try:
        if stream.read(len(MAGIC)) != MAGIC:
            return None
        while _add_next(stream, found, known):
            found.mark(stream.tell())
    except EndOfFileError as error:
        found.damage = reason_of(error)
    except DamagedRecordingError as error:
        found.damage = error.reason
    except Exception:  # noqa: BLE001 - who reads the messages meets it again, and names it
        return None
    finally:
        stream.close()
    return found if found.topics else None


def _add_next(stream: WholeReads, found: Survey, known: KnownChannels) -> bool:
    """Add what the next record tells; False where no messages follow."""
    opcode, length = _next_head(stream)
    end = stream.tell() + length
    if opcode == Opcode.CHUNK:
        _add_chunk(stream, end, found, known)
        return True
    if length > stream.remaining:
        raise EndOfFileError
    if opcode == Opcode.MESSAGE:
        channel, _, log_time_ns, _ = MESSAGE_HEAD.unpack(stream.read(MESSAGE_HEAD.size))
        found.add(known.streams[channel].topic_alone, 1, (log_time_ns, log_time_ns), length)
    elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        known.learn(opcode, memoryview(stream.read(length)))
    stream.seek(end)
    return opcode not in (Opcode.DATA_END, Opcode.FOOTER)


def _next_head(stream: WholeReads) -> tuple[int, int]:
    head = stream.read(RECORD_HEAD.size)
    opcode, length = RECORD_HEAD.unpack(head)
    return record_length(head) if opcode in _BOUNDED else (opcode, length)


def _add_chunk(stream: WholeReads, end: int, found: Survey, known: KnownChannels) -> None:
    start, held_end = stream.tell(), min(end, stream.tell() + stream.remaining)
    span, unpacked_bytes = chunk_claims(stream.read(min(_MOST_CLAIMS_BYTES, held_end - start)))
    found.latest_ns = max(found.latest_ns, span[1])
    stream.seek(held_end)
    told = _message_indexes(stream, span)
    behind = stream.tell()
    if told and told.keys() <= known.streams.keys():
        for channel, (count, times) in told.items():
            found.add(known.streams[channel].topic_alone, count, times, unpacked_bytes)
            unpacked_bytes = 0
        return
    if not told and stream.remaining:
        raise _NotToldError
    stream.seek(start)
    with damage_named(known.where):
        for message in known.messages_of(Opcode.CHUNK, stream.view(held_end - start)):
            found.add(message.topic_alone, 1, (message.log_time_ns, message.log_time_ns), len(message.data))
    if held_end < end:
        raise EndOfFileError
    stream.seek(behind)


def _message_indexes(stream: WholeReads, span: Span) -> _Told:
    """Those that come next; none where the file ends within them.

    Raises:
        _NotToldError: they contradict the chunk.
    """
    told: _Told = {}
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
                raise _NotToldError
            told[int.from_bytes(record[:2], "little")] = len(times), (first, last)
    return told
