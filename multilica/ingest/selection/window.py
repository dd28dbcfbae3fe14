# SPDX-License-Identifier: Apache-2.0
"""The frames of each LiDAR in a snapshot."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError, UnreadableSourceError
from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.messages.cloud import Cloud, is_cloud
from multilica.ingest.recording import Recording
from multilica.ingest.selection.sampling import PATIENCE_NS, evenly, sampled, until_full
from multilica.ingest.selection.time_range import TimeRange, find_time_range
from multilica.ingest.selection.topic_frames import TopicFrames, clock_notes


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """The collected frames.

    Args:
        clouds: topic -> its frames, oldest first; topics without any are left out.
        broken: topic -> error, for topics whose frames are all broken.
        notes: what the user should know.
        faults: the notes on unusable parts of the recording.
    """

    clouds: Mapping[str, tuple[Cloud, ...]]
    broken: Mapping[str, str]
    notes: tuple[str, ...]
    faults: tuple[str, ...] = ()


def collect_frames(recording: Recording, topics: Collection[str], config: IngestConfig, label: str) -> Window:
    """Collect `config.frames` frames of each topic in the configured window.

    Broken frames are skipped. Reading ends when there are enough frames, when the LiDARs that lack some have fallen
    silent, or where the recording is damaged.

    Raises:
        UnfitSnapshotError: the recording ends before the window begins.
        UnreadableSourceError: it is damaged before the first frame.
    """
    times = find_time_range(recording, config, label)
    streams = [TopicFrames(topic, _wanted(recording, topic, config)) for topic in sorted(topics)]
    damage = _fill({stream.topic: stream for stream in streams}, recording, times, config.frames)
    faults = [fault for stream in streams for fault in stream.faults()]
    shortages = [note for stream in streams for note in _shortages(stream, streams, damage)]
    if damage and all(stream.is_full for stream in streams):
        shortages.append(f"{label} is damaged: {damage}; all wanted scans lie before that.")
    remarks = [*times.notes, *(remark for stream in streams for remark in stream.remarks()), *clock_notes(streams)]
    clouds = {stream.topic: stream.by_time() for stream in streams if stream.clouds}
    unread = {stream.topic: [*stream.broken, *([] if clouds else stream.lost)] for stream in streams}
    return Window(
        clouds,
        {topic: sentences[0] for topic, sentences in unread.items() if sentences and topic not in clouds},
        (*faults, *shortages, *remarks),
        (*(shortages if damage else ()), *faults),
    )


def require_frames(window: Window, topics: Collection[str], config: IngestConfig, label: str) -> None:
    """Check that there is a frame, and one of every topic that was asked for by name.

    Raises:
        UnreadableSourceError: all frames are broken, or all of a topic that was asked for by name; with
            `config.strict`, any fault.
        UnfitSnapshotError: no frame lies in the window.
    """
    if config.strict and window.faults:
        raise UnreadableSourceError(f"{label} is refused, as ingest.strict is set: {window.faults[0]}")
    has_frames = bool(window.clouds.keys() & set(topics))
    for topic in sorted(topics):
        if topic in window.broken and (topic in (*config.topics.values(), *config.only) or not has_frames):
            raise UnreadableSourceError(window.broken[topic])
        if topic not in window.clouds and topic in config.topics.values():
            raise UnfitSnapshotError(f"{label} has no scan of '{topic}' after {config.start_s:g} s.")
    if not has_frames:
        raise UnfitSnapshotError(f"{label} has no readable scan after {config.start_s:g} s.")


def _wanted(recording: Recording, topic: str, config: IngestConfig) -> int:
    if recording.damage:
        return config.frames
    count = sum(known.count for known in recording.topics if known.name == topic and is_cloud(known))
    return min(config.frames, count)


def _fill(streams: Mapping[str, TopicFrames], recording: Recording, times: TimeRange, frames: int) -> str:
    """Fill the streams; return why reading ended early or what is known to be missing."""
    messages = until_full(recording, streams, times.start_ns)
    if times.end_ns is not None:
        spread_ns = evenly(times.start_ns, times.end_ns, frames)
        messages = (message for _, message in sampled(recording, streams.keys(), spread_ns, times.end_ns))
    try:
        for message in messages:
            streams[message.topic].take(message)
            if all(stream.is_full for stream in streams.values()):
                break
    except DamagedRecordingError as error:
        if not any(stream.clouds for stream in streams.values()):
            raise
        return error.reason
    return recording.damage


def _shortages(stream: TopicFrames, streams: list[TopicFrames], damage: str) -> list[str]:
    taken = len(stream.clouds)
    if damage and not stream.is_full:
        return [f"'{stream.topic}': {taken} of {stream.wanted} scans, then {damage}."]
    if stream.fell_silent:
        patience_s = PATIENCE_NS / 1e9
        return [f"'{stream.topic}' fell silent: {taken} of {stream.wanted} scans, then none for {patience_s:.0f} s."]
    if taken + len(stream.broken) < max(len(other.clouds) for other in streams):
        scans = "1 scan" if taken == 1 else f"{taken} scans"
        return [f"'{stream.topic}' has {scans} in the window, others have more."]
    return []
