# SPDX-License-Identifier: Apache-2.0
"""MCAP files."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from pathlib import Path
from typing import IO, cast

from mcap.reader import McapReader, make_reader
from mcap.summary import Summary

from multilica.ingest.damage import DamagedRecordingError, damage_named
from multilica.ingest.mcap_records import message_of, topics_of
from multilica.ingest.mcap_scan import open_unindexed
from multilica.ingest.recording import Message, Recording, Span, Topic
from multilica.ingest.whole_reads import WholeReads

__all__ = ["open_file"]


def open_file(path: Path) -> Recording:
    """Open an MCAP file: by its index, or from front to end where that is missing.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """
    stream = WholeReads.of_file(path)
    summary = _summary(stream)
    if summary is None or summary.statistics is None or not summary.chunk_indexes:
        stream.close()
        return open_unindexed(path)
    counts = summary.statistics.channel_message_counts
    return IndexedMcap(path, stream, topics_of(summary.channels.values(), summary.schemas, counts))


def _summary(stream: WholeReads) -> Summary | None:
    try:
        with damage_named("the index"):
            return make_reader(cast(IO[bytes], stream)).get_summary()
    except DamagedRecordingError:
        return None


class IndexedMcap:
    """An MCAP file of which only the chunks that are needed are read."""

    format = "MCAP"
    damage = ""

    def __init__(self, path: Path, stream: WholeReads, topics: tuple[Topic, ...]) -> None:
        self.topics = topics
        self._path = path
        self._stream = stream

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Read from the first and the last chunk that hold one of the topics."""
        with damage_named(str(self._path)):
            first = next(self._reader().iter_messages(topics), None)
            last = next(self._reader().iter_messages(topics, reverse=True), None)
        return None if first is None or last is None else (first[2].log_time, last[2].log_time)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Iterator[Message]:
        """In the order of log times."""
        with damage_named(str(self._path)):
            for record in self._reader().iter_messages(topics, starting_at=start_ns):
                yield message_of(record, self._path)

    def close(self) -> None:
        """Close the file."""
        self._stream.close()

    def _reader(self) -> McapReader:
        self._stream.seek(0)
        return make_reader(cast(IO[bytes], self._stream), validate_crcs=True)
