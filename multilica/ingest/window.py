# SPDX-License-Identifier: Apache-2.0
"""The frames of each LiDAR that make up the snapshot."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError, UnreadableSourceError
from multilica.ingest.cloud import Cloud, decode_cloud, is_cloud
from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.recording import Message, Recording

__all__ = ["Window", "collect_frames", "require_frames"]

_NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """What was taken.

    Args:
        clouds: topic -> its frames, oldest first; topics without any are left out.
        broken: topic -> what is wrong, for topics of which every frame is broken.
        notes: what the user should know.
    """

    clouds: Mapping[str, tuple[Cloud, ...]]
    broken: Mapping[str, str]
    notes: tuple[str, ...]


@dataclass(slots=True)
class _Stream:
    """What was taken of one topic so far."""

    topic: str
    wanted: int
    clouds: list[Cloud] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)

    @property
    def is_full(self) -> bool:
        return len(self.clouds) >= self.wanted

    def take(self, message: Message) -> None:
        if self.is_full or not is_cloud(message):
            return
        try:
            self.clouds.append(decode_cloud(message))
        except UnreadableSourceError as error:
            self.broken.append(str(error))


def collect_frames(recording: Recording, topics: Collection[str], config: IngestConfig, label: str) -> Window:
    """Take `config.frames` frames of each topic, from `config.start_s` on.

    Broken frames are passed over. Reading ends when there are enough frames, or where the recording is damaged.

    Args:
        topics: names of point cloud topics.
        label: the source, for messages.

    Raises:
        UnfitSnapshotError: the recording ends before the window begins.
        UnreadableSourceError: it is damaged before the first frame.
    """
    start_ns, notes = _start(recording, config.start_s, label)
    streams = [_Stream(topic, _wanted(recording, topic, config)) for topic in sorted(topics)]
    damage = _fill({stream.topic: stream for stream in streams}, recording, start_ns)
    notes += [note for stream in streams for note in _notes(stream, streams, damage)]
    if damage and all(stream.is_full for stream in streams):
        notes.append(f"{label} is damaged: {damage}; the scans that were asked for lie before that.")
    return Window(
        {stream.topic: _by_time(stream.clouds) for stream in streams if stream.clouds},
        {stream.topic: stream.broken[0] for stream in streams if stream.broken and not stream.clouds},
        tuple(notes),
    )


def require_frames(window: Window, topics: Collection[str], config: IngestConfig, label: str) -> None:
    """Check that there is a frame at all, and one of every topic that was asked for by name.

    Raises:
        UnreadableSourceError: all frames of a topic are broken.
        UnfitSnapshotError: no frame lies in the window.
    """
    for topic in sorted(topics):
        if topic in window.broken:
            raise UnreadableSourceError(window.broken[topic])
        if topic not in window.clouds and topic in config.topics.values():
            raise UnfitSnapshotError(f"{label} has no scan of '{topic}' from {config.start_s:g} s on.")
    if not window.clouds.keys() & set(topics):
        raise UnfitSnapshotError(f"{label} has no scan that can be read from {config.start_s:g} s on.")


def _start(recording: Recording, start_s: float, label: str) -> tuple[int, list[str]]:
    if start_s == 0.0:
        return 0, []
    span = recording.span_ns({topic.name for topic in recording.topics if is_cloud(topic)})
    if span is None:
        return 0, ["Point files have no time: ingest.start_s has no effect."]
    duration_s = (span[1] - span[0]) / _NS_PER_S
    if start_s > duration_s:
        raise UnfitSnapshotError(
            f"{label} has no point cloud {start_s:g} s after its first one: they span {duration_s:.3f} s; "
            "set ingest.start_s to less."
        )
    return span[0] + round(start_s * _NS_PER_S), []


def _wanted(recording: Recording, topic: str, config: IngestConfig) -> int:
    if recording.damage:
        return config.frames
    count = sum(known.count for known in recording.topics if known.name == topic and is_cloud(known))
    return min(config.frames, count)


def _fill(streams: Mapping[str, _Stream], recording: Recording, start_ns: int) -> str:
    """Take frames until there are enough; why reading ended before, or what is known to be missing."""
    try:
        for message in recording.messages(streams.keys(), start_ns):
            streams[message.topic].take(message)
            if all(stream.is_full for stream in streams.values()):
                break
    except DamagedRecordingError as error:
        if not any(stream.clouds for stream in streams.values()):
            raise
        return error.reason
    return recording.damage


def _notes(stream: _Stream, streams: list[_Stream], damage: str) -> list[str]:
    notes: list[str] = []
    taken, broken = len(stream.clouds), len(stream.broken)
    if broken:
        scans = f"{broken} of {broken + taken} scans of '{stream.topic}'"
        notes.append(f"{scans} are broken and left out: {stream.broken[0]}")
    if damage and not stream.is_full:
        notes.append(f"'{stream.topic}': {taken} of {stream.wanted} scans, then {damage}.")
    elif taken < max(len(other.clouds) for other in streams):
        notes.append(f"'{stream.topic}' has {taken} scans in the window, others have more.")
    frame_ids = sorted({cloud.frame_id for cloud in stream.clouds})
    if len(frame_ids) > 1:
        notes.append(f"'{stream.topic}' has scans in several frames ({', '.join(frame_ids)}), taken as one.")
    return notes


def _by_time(clouds: list[Cloud]) -> tuple[Cloud, ...]:
    return tuple(sorted(clouds, key=lambda cloud: cloud.scan.stamp_ns))
