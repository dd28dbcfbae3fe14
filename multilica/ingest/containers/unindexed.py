# SPDX-License-Identifier: Apache-2.0
"""Recordings without an index, as a killed recorder leaves them."""

from __future__ import annotations

import heapq
from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sized
from dataclasses import dataclass, field
from operator import attrgetter, itemgetter
from typing import cast

from multilica.ingest.recording import (
    DamagedRecordingError,
    Messages,
    RawMessage,
    Recording,
    Span,
    Topic,
    damage_named,
    joint_span,
    joint_topics,
)

Part = tuple[int, Iterator[RawMessage]]
"""Position behind a record of the file, and the messages of the record, which may be a chunk."""

_MAX_KEPT_BYTES = 128 << 20
"""Recordings up to this size are kept in memory, as finding out what a file holds takes as long as reading it."""
_MARK_BYTES = 1 << 20
"""Distance of the positions that are remembered to start at."""
_KEPT_MESSAGE_BYTES = 256
"""Memory of a message besides its data."""
_MAX_BACK_NS = 2 * 10**9
"""Recorders write messages of several threads a little out of order."""


@dataclass(slots=True)
class Survey:
    """The contents of a recording.

    Args:
        counts: messages by topic; the topics' own counts are zero.
        spans: log times by name of the topic.
        marks: positions in the file, each with the latest log time before it.
        goes_back, is_sorted: some of it is much older than what lies before it; each topic alone is in order.
    """

    counts: Counter[Topic] = field(default_factory=Counter)
    spans: dict[str, Span] = field(default_factory=dict)
    unpacked_bytes: int = 0
    damage: str = ""
    latest_ns: int = 0
    marks: list[tuple[int, int]] = field(default_factory=list)
    goes_back: bool = False
    is_sorted: bool = True

    def begin_part(self, first_ns: int) -> None:
        """Note the earliest log time of what is added next."""
        self.goes_back |= first_ns < self.latest_ns - _MAX_BACK_NS

    def add(self, topic: Topic, count: int, span: Span, unpacked_bytes: int = 0) -> None:
        """Add `count` messages of a topic."""
        self.counts[topic] += count
        first, last = self.spans.get(topic.name, span)
        self.is_sorted &= topic.name not in self.spans or span[0] >= last - _MAX_BACK_NS
        self.spans[topic.name] = min(first, span[0]), max(last, span[1])
        self.unpacked_bytes += unpacked_bytes
        self.latest_ns = max(self.latest_ns, span[1])

    def add_message(self, message: RawMessage, unpacked_bytes: int = 0) -> None:
        """Add one message."""
        topic = Topic(message.topic, message.message_type, message.encoding, lidar=message.lidar)
        self.begin_part(message.log_time_ns)
        self.add(topic, 1, (message.log_time_ns, message.log_time_ns), unpacked_bytes)

    def mark(self, place: int) -> None:
        """Remember a position; everything before it was added."""
        if place - (self.marks[-1][0] if self.marks else 0) >= _MARK_BYTES:
            self.marks.append((place, self.latest_ns))

    def begin(self, start_ns: int) -> int:
        """Return the last known position with only messages before `start_ns` in front of it."""
        index = bisect_left(self.marks, start_ns, key=itemgetter(1))
        return self.marks[index - 1][0] if index else 0


class UnindexedRecording(Recording):
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
        self._kept: list[RawMessage] | None = None
        self._error: DamagedRecordingError | None = None
        found = survey()
        self._survey = self._read() if found is None or found.unpacked_bytes <= _MAX_KEPT_BYTES else found
        self.topics = joint_topics(self._survey.counts.items())
        self.damage = self._survey.damage

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Return the span, which is known since the file was opened."""
        return joint_span(span for name, span in self._survey.spans.items() if name in topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield messages in the order of writing; by log time if the topics were written one after the other."""
        errors: list[DamagedRecordingError] = []
        # A clock that was set back goes back within each topic, too.
        is_by_topic = self._survey.goes_back and self._survey.is_sorted
        parts = [{topic} for topic in sorted(topics)] if is_by_topic else [{*topics}]
        yield from heapq.merge(
            *(self._written(each, start_ns, errors) for each in parts), key=attrgetter("log_time_ns")
        )
        if errors:
            raise errors[0]

    def _written(self, topics: Collection[str], start_ns: int, errors: list[DamagedRecordingError]) -> Messages:
        """Yield messages in the order of writing; add what ends them too early to the errors."""
        try:
            with damage_named(self._where):
                parts = self._scan(self._survey.begin(start_ns)) if self._kept is None else [(0, iter(self._kept))]
                for _, messages in parts:
                    yield from (each for each in messages if each.topic in topics and each.log_time_ns >= start_ns)
        except DamagedRecordingError as error:
            errors.append(error)
        if self._error is not None:
            errors.append(self._error)

    def _read(self) -> Survey:
        found, kept, kept_bytes = Survey(), list[RawMessage](), 0
        try:
            with damage_named(self._where):
                for behind, messages in self._scan(0):
                    chunk: Sized | None = None
                    for message in messages:
                        found.add_message(message)
                        # A message keeps all of its chunk in memory.
                        before, chunk = chunk, _chunk_of(message)
                        kept_bytes += _KEPT_MESSAGE_BYTES + (0 if chunk is before else len(chunk))
                        if kept_bytes <= _MAX_KEPT_BYTES:
                            kept.append(message)
                        else:
                            kept.clear()
                    found.mark(behind)
        except DamagedRecordingError as error:
            if not found.counts:
                raise
            found.damage, self._error = error.reason, error
        self._kept = kept if kept_bytes <= _MAX_KEPT_BYTES else None
        return found


def _chunk_of(message: RawMessage) -> Sized:
    return cast(Sized, message.data.obj) if isinstance(message.data, memoryview) else message.data
