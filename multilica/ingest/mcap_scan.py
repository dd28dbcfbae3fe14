# SPDX-License-Identifier: Apache-2.0
"""MCAP files without an index, as a recorder that died leaves them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import IO, cast

from mcap.reader import NonSeekingReader
from mcap.records import Channel, Schema

from multilica.ingest.damage import DamagedRecordingError, damage_named
from multilica.ingest.mcap_records import Record, message_of, topics_of
from multilica.ingest.recording import Message, Recording, Span, Topic, joint_span
from multilica.ingest.whole_reads import WholeReads

__all__ = ["open_unindexed"]


def open_unindexed(path: Path) -> Recording:
    """Open an MCAP file by reading it from the front for as long as it makes sense.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """
    channels: dict[int, Channel] = {}
    schemas: dict[int, Schema] = {}
    counts: Counter[int] = Counter()
    spans: dict[str, Span] = {}
    damage = ""
    try:
        for schema, channel, message in _records(path):
            channels[channel.id] = channel
            if schema is not None:
                schemas[schema.id] = schema
            counts[channel.id] += 1
            first, last = spans.get(channel.topic, (message.log_time, message.log_time))
            spans[channel.topic] = min(first, message.log_time), max(last, message.log_time)
    except DamagedRecordingError as error:
        if not counts:
            raise
        damage = error.reason
    return UnindexedMcap(path, topics_of(channels.values(), schemas, counts), spans, damage)


class UnindexedMcap:
    """An MCAP file that is read in the order of writing."""

    format = "MCAP without index"

    def __init__(self, path: Path, topics: tuple[Topic, ...], spans: Mapping[str, Span], damage: str) -> None:
        self.topics = topics
        self.damage = damage
        self._path = path
        self._spans = spans

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Known since the file was opened."""
        return joint_span(self._spans, topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Iterator[Message]:
        """In the order of writing."""
        for record in _records(self._path):
            if record[1].topic in topics and record[2].log_time >= start_ns:
                yield message_of(record, self._path)

    def close(self) -> None:
        """Nothing stays open."""


def _records(path: Path) -> Iterator[Record]:
    stream = WholeReads.of_file(path)
    try:
        with damage_named(str(path)):
            reader = NonSeekingReader(cast(IO[bytes], stream), validate_crcs=True)
            # In log-time order the reader would first load the whole file.
            yield from reader.iter_messages(log_time_order=False)
    finally:
        stream.close()
