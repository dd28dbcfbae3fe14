# SPDX-License-Identifier: Apache-2.0
"""A bag that was split over several files."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence

from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.recording import Messages, Recording, Span, Topic

__all__ = ["SplitRecording"]


class SplitRecording:
    """Several recordings, one after the other.

    Args:
        parts: open recordings, oldest first.
        damage: what is known to be missing.
    """

    def __init__(self, parts: Sequence[Recording], damage: str = "") -> None:
        files = "1 file" if len(parts) == 1 else f"{len(parts)} files"
        self.format = f"{parts[0].format}, {files}"
        self.damage = damage or next((part.damage for part in parts if part.damage), "")
        self.is_indexed = all(part.is_indexed for part in parts)
        self.topics = _joint_topics(parts)
        self._parts = tuple(parts)

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Over all parts."""
        spans = [span for part in self._parts if (span := part.span_ns(topics)) is not None]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Part after part; what lies behind the damage in one is lost, not what the next ones hold."""
        damage: DamagedRecordingError | None = None
        for part in self._parts:
            try:
                yield from part.messages(topics, start_ns)
            except DamagedRecordingError as error:
                damage = damage or error
        if damage is not None:
            raise damage

    def close(self) -> None:
        """Close every part."""
        for part in self._parts:
            part.close()


def _joint_topics(parts: Sequence[Recording]) -> tuple[Topic, ...]:
    counts: Counter[tuple[str, str, str, str]] = Counter()
    for part in parts:
        for topic in part.topics:
            counts[topic.name, topic.message_type, topic.encoding, topic.lidar] += topic.count
    return tuple(Topic(*key[:3], count, key[3]) for key, count in sorted(counts.items()))
