# SPDX-License-Identifier: Apache-2.0
"""Recordings without an index, as a recorder that died leaves them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sized
from typing import cast

from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.recording import Message, Messages, Span, Topic, joint_span

__all__ = ["UnindexedRecording"]

_MAX_KEPT_BYTES = 128 << 20
"""Recordings up to this size are unpacked once; to know what is in one takes as long as to read it."""
_MESSAGE_BYTES = 256
"""What a message takes beside its data."""


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
        self._kept: list[Message] | None = []
        self._error: DamagedRecordingError | None = None
        self.topics = self._survey()

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Known since the file was opened."""
        return joint_span(self._spans, topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """In the order of writing."""
        for message in self._once_more():
            if message.topic in topics and message.log_time_ns >= start_ns:
                yield message

    def close(self) -> None:
        """Let go of what was kept; nothing stays open."""
        self._kept = None

    def _once_more(self) -> Iterator[Message]:
        if self._kept is None:
            yield from self._scan()
            return
        yield from self._kept
        if self._error is not None:
            raise self._error

    def _survey(self) -> tuple[Topic, ...]:
        counts: Counter[tuple[str, str, str, str]] = Counter()
        kept_bytes, chunk = 0, None
        try:
            for message in self._scan():
                # A message keeps all of the chunk that it lies in.
                before, chunk = chunk, _chunk_of(message)
                kept_bytes += _MESSAGE_BYTES + (0 if chunk is before else len(chunk))
                if kept_bytes > _MAX_KEPT_BYTES:
                    self._kept = None
                if self._kept is not None:
                    self._kept.append(message)
                counts[message.topic, message.message_type, message.encoding, message.lidar] += 1
                first, last = self._spans.get(message.topic, (message.log_time_ns, message.log_time_ns))
                self._spans[message.topic] = min(first, message.log_time_ns), max(last, message.log_time_ns)
        except DamagedRecordingError as error:
            if not counts:
                raise
            self.damage, self._error = error.reason, error
        return tuple(Topic(*key[:3], total, key[3]) for key, total in sorted(counts.items()))


def _chunk_of(message: Message) -> Sized:
    return cast(Sized, message.data.obj) if isinstance(message.data, memoryview) else message.data
