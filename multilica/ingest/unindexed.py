# SPDX-License-Identifier: Apache-2.0
"""Recordings without an index, as a recorder that died leaves them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator

from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.recording import Message, Messages, Span, Topic, joint_span

__all__ = ["UnindexedRecording"]


class UnindexedRecording:
    """A recording that is read from the front, for as long as it makes sense.

    Args:
        title: as `Recording.format`.
        scan: every message in the order of writing; raises DamagedRecordingError where it cannot go on.

    Raises:
        DamagedRecordingError: not a single message can be read.
    """

    is_indexed = False

    def __init__(self, title: str, scan: Callable[[], Iterator[Message]]) -> None:
        self.format = title
        self.damage = ""
        self._scan = scan
        self._spans: dict[str, Span] = {}
        self.topics = self._survey()

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Known since the file was opened."""
        return joint_span(self._spans, topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """In the order of writing."""
        for message in self._scan():
            if message.topic in topics and message.log_time_ns >= start_ns:
                yield message

    def close(self) -> None:
        """Nothing stays open."""

    def _survey(self) -> tuple[Topic, ...]:
        counts: Counter[tuple[str, str, str, str]] = Counter()
        try:
            for message in self._scan():
                counts[message.topic, message.message_type, message.encoding, message.lidar] += 1
                first, last = self._spans.get(message.topic, (message.log_time_ns, message.log_time_ns))
                self._spans[message.topic] = min(first, message.log_time_ns), max(last, message.log_time_ns)
        except DamagedRecordingError as error:
            if not counts:
                raise
            self.damage = error.reason
        return tuple(Topic(*key[:3], total, key[3]) for key, total in sorted(counts.items()))
