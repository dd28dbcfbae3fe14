# SPDX-License-Identifier: Apache-2.0
"""Recordings without index, as a killed recorder leaves them."""

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sized
from dataclasses import dataclass, field
from operator import itemgetter
from typing import cast

from multilica.ingest.recording import (
    DamagedRecordingError,
    Messages,
    RawMessage,
    Span,
    Topic,
    damage_named,
    joint_span,
    joint_topics,
)

Part = tuple[int, Iterator[RawMessage]]
"""Position behind a record of the file, and the messages of the record, which may be a chunk."""

_MAX_KEPT_BYTES = 128 << 20
"""Messages up to this size are kept in memory, as finding out what a file holds takes as long as reading it."""
_MARK_BYTES = 1 << 20
"""Distance of the positions that are remembered to start at."""
_MESSAGE_BYTES = 256
"""Memory of a message besides its data."""


@dataclass(slots=True)
class Survey:
    """The contents of a recording.

    Args:
        counts: messages by topic; the topics' own counts are zero.
        spans: log times by name of the topic.
        marks: positions in the file, each with the latest log time before it.
    """

    counts: Counter[Topic] = field(default_factory=Counter)
    spans: dict[str, Span] = field(default_factory=dict)
    unpacked_bytes: int = 0
    damage: str = ""
    latest_ns: int = 0
    marks: list[tuple[int, int]] = field(default_factory=list)

    def add(self, topic: Topic, count: int, span: Span, unpacked_bytes: int = 0) -> None:
        """Add `count` messages of a topic."""
        self.counts[topic] += count
        first, last = self.spans.get(topic.name, span)
        self.spans[topic.name] = min(first, span[0]), max(last, span[1])
        self.unpacked_bytes += unpacked_bytes
        self.latest_ns = max(self.latest_ns, span[1])

    def add_message(self, message: RawMessage, unpacked_bytes: int = 0) -> None:
        """Add one message."""
        topic = Topic(message.topic, message.message_type, message.encoding, lidar=message.lidar)
        self.add(topic, 1, (message.log_time_ns, message.log_time_ns), unpacked_bytes)

    def mark(self, place: int) -> None:
        """Remember a position; everything before it was added."""
        if place - (self.marks[-1][0] if self.marks else 0) >= _MARK_BYTES:
            self.marks.append((place, self.latest_ns))

    def begin(self, start_ns: int, least: int) -> int:
        """Return the last known position, at least `least`, with only messages before `start_ns` in front of it."""
        index = bisect_left(self.marks, start_ns, key=itemgetter(1))
        return max(least, self.marks[index - 1][0]) if index else least


class UnindexedRecording:
    """A recording that is read from the front up to the first damage.

    Args:
        scan: yields the parts of the file from a position on, in the order of writing; raises any error where it
            cannot go on. It starts at 0 or where it has been before.
        survey: finds out what the file holds without that; returns None if it cannot.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """

    is_indexed = False

    def __init__(
        self,
        title: str,
        where: str,
        scan: Callable[[int], Iterator[Part]],
        survey: Callable[[], Survey | None] = lambda: None,
    ) -> None:
        self.format = title
        self._where = where
        self._scan = scan
        self._kept: list[RawMessage] = []
        self._kept_until: int | None = 0
        self._error: DamagedRecordingError | None = None
        found = survey()
        self._survey = self._read() if found is None or found.unpacked_bytes <= _MAX_KEPT_BYTES else found
        self.topics = joint_topics(self._survey.counts.items())
        self.damage = self._survey.damage

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Return the span, which is known since the file was opened."""
        return joint_span(span for name, span in self._survey.spans.items() if name in topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield messages in the order of writing."""
        for message in self._all_messages(start_ns):
            if message.topic in topics and message.log_time_ns >= start_ns:
                yield message

    def close(self) -> None:
        """Release the kept messages; no file stays open."""
        self._kept = []

    def _all_messages(self, start_ns: int) -> Iterator[RawMessage]:
        yield from self._kept
        if self._kept_until is not None:
            with damage_named(self._where):
                for _, messages in self._scan(self._survey.begin(start_ns, self._kept_until)):
                    yield from messages
        if self._error is not None:
            raise self._error

    def _read(self) -> Survey:
        found, kept_bytes, whole_parts = Survey(), 0, 0
        try:
            with damage_named(self._where):
                for behind, messages in self._scan(0):
                    chunk: Sized | None = None
                    for message in messages:
                        found.add_message(message)
                        # A message keeps all of its chunk in memory.
                        before, chunk = chunk, _chunk_of(message)
                        kept_bytes += _MESSAGE_BYTES + (0 if chunk is before else len(chunk))
                        if kept_bytes <= _MAX_KEPT_BYTES:
                            self._kept.append(message)
                    found.mark(behind)
                    if kept_bytes <= _MAX_KEPT_BYTES:
                        self._kept_until, whole_parts = behind, len(self._kept)
        except DamagedRecordingError as error:
            if not found.counts:
                raise
            found.damage, self._error = error.reason, error
        if kept_bytes <= _MAX_KEPT_BYTES:
            self._kept_until = None
        else:
            del self._kept[whole_parts:]
        return found


def _chunk_of(message: RawMessage) -> Sized:
    return cast(Sized, message.data.obj) if isinstance(message.data, memoryview) else message.data
