# SPDX-License-Identifier: Apache-2.0
"""Several recordings of one moment, by a recorder per LiDAR."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from itertools import islice

from multilica.errors import UnreadableSourceError, UsageError
from multilica.ingest.cloud import decode_cloud, is_cloud
from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.recording import Message, Messages, Recording, Span, Topic
from multilica.ingest.remote_file import SourceFile

__all__ = ["JoinedRecording"]

_LOOKED_AT = 4
"""Scans of which one tells its frame; the others may be broken."""


class JoinedRecording:
    """Recordings side by side; a topic that several of them have is preceded by the file, as in ``left.bag:/points``.

    Args:
        parts: open recordings with the file that each comes from.

    Raises:
        UsageError: two of them hold the same LiDAR.
    """

    def __init__(self, parts: Sequence[tuple[SourceFile, Recording]]) -> None:
        _require_disjoint(parts)
        self._parts = tuple((recording, _public_names(path, recording, parts)) for path, recording in parts)
        self.format = " beside ".join(sorted({recording.format for recording, _ in self._parts}))
        self.is_indexed = all(recording.is_indexed for recording, _ in self._parts)
        self.damage = next((recording.damage for recording, _ in self._parts if recording.damage), "")
        self.topics: tuple[Topic, ...] = tuple(
            sorted(
                (replace(topic, name=names[topic.name]) for part, names in self._parts for topic in part.topics),
                key=lambda topic: topic.name,
            )
        )

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Over all of them."""
        spans = [span for part, names in self._parts if (span := part.span_ns(_own(names, topics))) is not None]
        return (min(first for first, _ in spans), max(last for _, last in spans)) if spans else None

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """In the order of log times; damage of one recording is told when the others have ended."""
        damage: list[DamagedRecordingError] = []
        streams = [
            _renamed(part, names, _own(names, topics), start_ns, damage)
            for part, names in self._parts
            if _own(names, topics)
        ]
        yield from heapq.merge(*streams, key=lambda message: message.log_time_ns)
        if damage:
            raise damage[0]

    def close(self) -> None:
        """Close them all."""
        with ExitStack() as stack:
            for part, _ in self._parts:
                stack.enter_context(closing(part))


def _public_names(
    path: SourceFile, recording: Recording, parts: Sequence[tuple[SourceFile, Recording]]
) -> dict[str, str]:
    """Name of a topic in its recording -> name among all."""
    counts = Counter(name for _, part in parts for name in {topic.name for topic in part.topics})
    return {
        topic.name: topic.name if counts[topic.name] == 1 else f"{path.name}:{topic.name}" for topic in recording.topics
    }


def _own(names: dict[str, str], topics: Collection[str]) -> list[str]:
    return [own for own, public in names.items() if public in topics]


def _renamed(
    part: Recording, names: dict[str, str], topics: list[str], start_ns: int, damage: list[DamagedRecordingError]
) -> Iterator[Message]:
    try:
        for message in part.messages(topics, start_ns):
            yield replace(message, topic=names[message.topic])
    except DamagedRecordingError as error:
        damage.append(error)


def _require_disjoint(parts: Sequence[tuple[SourceFile, Recording]]) -> None:
    """Refuse two recordings of one LiDAR: of the same name, or with the same frame id on the same topic."""
    holders: dict[tuple[str, str], SourceFile] = {}
    for path, recording in parts:
        for key in sorted(
            {_identity(recording, topic) for topic in recording.topics if is_cloud(topic) and topic.count}
        ):
            if key in holders:
                raise UsageError(
                    f"{holders[key]} and {path} both hold the LiDAR '{key[1] or key[0]}'; recordings of one snapshot "
                    "hold different LiDARs."
                )
            holders[key] = path


def _identity(recording: Recording, topic: Topic) -> tuple[str, str]:
    """Where a LiDAR is found, and what it is called there."""
    if topic.lidar:
        return "", topic.lidar
    with suppress(DamagedRecordingError), closing(recording.messages([topic.name])) as messages:
        for message in islice(messages, _LOOKED_AT):
            with suppress(UnreadableSourceError):
                return topic.name, decode_cloud(message).frame_id
    return topic.name, ""
