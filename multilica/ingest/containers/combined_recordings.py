# SPDX-License-Identifier: Apache-2.0
"""Several recordings as one."""

import heapq
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from itertools import islice

from multilica.errors import UnreadableSourceError, UsageError
from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.messages.cloud import decode_cloud, is_cloud
from multilica.ingest.recording import Messages, RawMessage, Recording, Span, Topic, joint_span, joint_topics
from multilica.ingest.remote.remote_file import SourceFile

_MAX_TRIES = 4
"""Scans to try for the frame id; the first ones may be broken."""


class SplitRecording:
    """Several open recordings, one after the other, oldest first."""

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


class JoinedRecording:
    """Recordings of the same moment; a topic in several of them is prefixed with its file, as in ``left.bag:/points``.

    Raises:
        UsageError: two of them hold the same LiDAR.
    """

    def __init__(self, parts: Sequence[tuple[SourceFile, Recording]]) -> None:
        _require_disjoint(parts)
        recordings = [recording for _, recording in parts]
        counts = Counter(name for part in recordings for name in {topic.name for topic in part.topics})
        self._parts = tuple(
            (
                recording,
                {
                    topic.name: topic.name if counts[topic.name] == 1 else f"{path.name}:{topic.name}"
                    for topic in recording.topics
                },
            )
            for path, recording in parts
        )
        self.format = " beside ".join(sorted({recording.format for recording in recordings}))
        self.is_indexed = all(recording.is_indexed for recording in recordings)
        self.damage = next((recording.damage for recording in recordings if recording.damage), "")
        topics = (replace(topic, name=names[topic.name]) for part, names in self._parts for topic in part.topics)
        self.topics: tuple[Topic, ...] = tuple(sorted(topics, key=lambda topic: topic.name))

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Return the span over all recordings."""
        return joint_span(part.span_ns(_own(names, topics)) for part, names in self._parts)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield messages by log time; damage of one recording is raised after the others have ended."""
        damage: list[DamagedRecordingError] = []
        streams = [
            _renamed(part, names, own, start_ns, damage) for part, names in self._parts if (own := _own(names, topics))
        ]
        yield from heapq.merge(*streams, key=lambda message: message.log_time_ns)
        if damage:
            raise damage[0]

    def close(self) -> None:
        """Close all recordings."""
        with ExitStack() as stack:
            for part, _ in self._parts:
                stack.enter_context(closing(part))


def _own(names: dict[str, str], topics: Collection[str]) -> list[str]:
    """Return the names of topics within their recording."""
    return [own for own, public in names.items() if public in topics]


def _renamed(
    part: Recording, names: dict[str, str], topics: list[str], start_ns: int, damage: list[DamagedRecordingError]
) -> Iterator[RawMessage]:
    try:
        for message in part.messages(topics, start_ns):
            yield replace(message, topic=names[message.topic])
    except DamagedRecordingError as error:
        damage.append(error)


def _require_disjoint(parts: Sequence[tuple[SourceFile, Recording]]) -> None:
    """Refuse two recordings of one LiDAR: of the same name, or with the same frame id on the same topic."""
    holders: dict[tuple[str, str], SourceFile] = {}
    for path, recording in parts:
        clouds = [topic for topic in recording.topics if is_cloud(topic) and topic.count]
        for key in sorted({_identity(recording, topic) for topic in clouds}):
            if key in holders:
                raise UsageError(
                    f"{holders[key]} and {path} both hold the LiDAR '{key[1] or key[0]}'; recordings of one snapshot "
                    "must hold different LiDARs."
                )
            holders[key] = path


def _identity(recording: Recording, topic: Topic) -> tuple[str, str]:
    """Return the topic and the frame id of a LiDAR; only its name if the recording names it."""
    if topic.lidar:
        return "", topic.lidar
    with suppress(DamagedRecordingError), closing(recording.messages([topic.name])) as messages:
        for message in islice(messages, _MAX_TRIES):
            with suppress(UnreadableSourceError):
                return topic.name, decode_cloud(message).frame_id
    return topic.name, ""
