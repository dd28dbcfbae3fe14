# SPDX-License-Identifier: Apache-2.0
"""Recordings without an index, as a recorder that died leaves them."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sized
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import cast

from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.recording import Message, Messages, Span, Topic, joint_span

__all__ = ["Part", "Survey", "UnindexedRecording"]

Part = tuple[int, Iterator[Message]]
"""The messages of one record of a file, be it a chunk of many, with the place behind it."""

_MAX_KEPT_BYTES = 128 << 20
"""So much of a recording is unpacked once; to know what is in one takes as long as to read it."""
_MARK_BYTES = 1 << 20
"""Places to begin at are remembered this far apart, lest there be one per message."""
_MESSAGE_BYTES = 256
"""What a message takes beside its data."""


@dataclass(slots=True)
class Survey:
    """What is in a recording.

    Args:
        counts: messages by topic, each topic with a count of zero.
        spans: log times by name of the topic.
        unpacked_bytes: size of the messages.
        damage: as of `Recording`.
        latest_ns: the latest log time.
        marks: places in the file, each with the latest log time before it.
    """

    counts: Counter[Topic] = field(default_factory=Counter)
    spans: dict[str, Span] = field(default_factory=dict)
    unpacked_bytes: int = 0
    damage: str = ""
    latest_ns: int = 0
    marks: list[tuple[int, int]] = field(default_factory=list)

    def add(self, topic: Topic, count: int, span: Span, unpacked_bytes: int = 0) -> None:
        """Add so many messages of a topic, whose own count is zero."""
        self.counts[topic] += count
        first, last = self.spans.get(topic.name, span)
        self.spans[topic.name] = min(first, span[0]), max(last, span[1])
        self.unpacked_bytes += unpacked_bytes
        self.latest_ns = max(self.latest_ns, span[1])

    def mark(self, place: int) -> None:
        """Tell that everything before a place in the file was added."""
        if place - (self.marks[-1][0] if self.marks else 0) >= _MARK_BYTES:
            self.marks.append((place, self.latest_ns))

    def begin(self, start_ns: int, least: int) -> int:
        """The last place that is known to have only earlier messages before it; `least` if none lies behind that."""
        index = bisect_left(self.marks, start_ns, key=itemgetter(1))
        return max(least, self.marks[index - 1][0]) if index else least

    @property
    def topics(self) -> tuple[Topic, ...]:
        """By name."""
        found = (replace(topic, count=count) for topic, count in self.counts.items())
        return tuple(sorted(found, key=lambda topic: (topic.name, topic.message_type, topic.encoding, topic.lidar)))


class UnindexedRecording:
    """A recording that is read from the front, for as long as it makes sense.

    Args:
        title: as `Recording.format`.
        scan: the parts of the file from a place on, 0 for its beginning, in the order of writing; raises
            DamagedRecordingError where it cannot go on. It begins elsewhere only where it has been before.
        survey: what can be told without that; None where nothing can.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """

    is_indexed = False

    def __init__(
        self, title: str, scan: Callable[[int], Iterator[Part]], survey: Callable[[], Survey | None] = lambda: None
    ) -> None:
        self.format = title
        self._scan = scan
        self._kept: list[Message] = []
        self._kept_until: int | None = 0
        self._error: DamagedRecordingError | None = None
        told = survey()
        self._survey = self._read() if told is None or told.unpacked_bytes <= _MAX_KEPT_BYTES else told
        self.topics = self._survey.topics
        self.damage = self._survey.damage

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Known since the file was opened."""
        return joint_span(self._survey.spans, topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """In the order of writing."""
        for message in self._once_more(start_ns):
            if message.topic in topics and message.log_time_ns >= start_ns:
                yield message

    def close(self) -> None:
        """Let go of what was kept; nothing stays open."""
        self._kept = []

    def _once_more(self, start_ns: int) -> Iterator[Message]:
        yield from self._kept
        if self._kept_until is not None:
            for _, messages in self._scan(self._survey.begin(start_ns, self._kept_until)):
                yield from messages
        if self._error is not None:
            raise self._error

    def _read(self) -> Survey:
        found, kept_bytes, whole_parts = Survey(), 0, 0
        try:
            for behind, messages in self._scan(0):
                chunk: Sized | None = None
                for message in messages:
                    found.add(message.topic_alone, 1, (message.log_time_ns, message.log_time_ns))
                    # A message keeps all of the chunk that it lies in.
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


def _chunk_of(message: Message) -> Sized:
    return cast(Sized, message.data.obj) if isinstance(message.data, memoryview) else message.data
