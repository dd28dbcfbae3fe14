# SPDX-License-Identifier: Apache-2.0
"""A bag that was split into several files."""

from collections.abc import Collection, Sequence

from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.recording import Messages, Recording, Span, joint_span, joint_topics

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
        self.topics = joint_topics((topic, topic.count) for part in parts for topic in part.topics)
        self._parts = tuple(parts)

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Return the span over all parts."""
        return joint_span(part.span_ns(topics) for part in self._parts)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield messages part after part; damage in one part does not affect the next ones."""
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
