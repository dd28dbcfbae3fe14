# SPDX-License-Identifier: Apache-2.0
"""The frames of each LiDAR in one time range."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from itertools import pairwise
from statistics import median

import numpy as np

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError, UnreadableSourceError, listed
from multilica.ingest.memory import memory_budget
from multilica.ingest.message_types import Cloud, decode_cloud, is_cloud
from multilica.ingest.recording import DamagedRecordingError, RawMessage, Recording, Span
from multilica.ingest.selection.absent import why_absent
from multilica.ingest.selection.sampling import PATIENCE_NS, evenly, sampled
from multilica.ingest.selection.time_range import TimeRange, find_time_range
from multilica.ingest.selection.topics import named_topics
from multilica.snapshot import Scan

_MAX_CLOCK_OFFSET_S = 0.5
"""A scan takes a tenth of a second and logging a little more; a larger difference means that clocks are not set."""
_MAX_BROKEN = 1000
_MAX_RATE_HZ = 50.0
"""LiDARs turn up to 25 times a second."""
_LEAST_SCANS = 5


@dataclass(frozen=True, slots=True, eq=False)
class Window:
    """The collected frames.

    Args:
        clouds: topic -> its frames, oldest first; topics without any are left out.
        broken: topic -> error, for topics whose frames are all broken.
        notes: what the user should know.
        faults: the notes on unusable parts of the recording.
        joined: topic -> error, for topics that hold the clouds of several LiDARs.
    """

    clouds: Mapping[str, tuple[Cloud, ...]]
    broken: Mapping[str, str]
    notes: tuple[str, ...]
    faults: tuple[str, ...] = ()
    joined: Mapping[str, str] = field(default_factory=dict)


def collect_frames(
    recording: Recording,
    topics: Collection[str],
    config: IngestConfig,
    label: str,
    times: TimeRange | None = None,
) -> Window:
    """Collect `config.frames` frames of each topic in a time range, or in the configured window.

    Broken frames are skipped. Reading ends when there are enough frames, when the LiDARs that lack some have fallen
    silent, or where the recording is damaged.

    Raises:
        UnfitSnapshotError: the recording ends before the window begins.
        UnreadableSourceError: it is damaged before the first frame.
    """
    times = times or find_time_range(recording, config, label, topics)
    counts: Counter[str] = Counter()
    for topic in filter(is_cloud, recording.topics):
        counts[topic.name] += topic.count
    frames = config.frames
    streams = [TopicFrames(name, frames if recording.damage else min(frames, counts[name])) for name in sorted(topics)]
    damage = _fill({stream.topic: stream for stream in streams}, recording, times, frames)
    faults = [fault for stream in streams for fault in stream.faults()]
    shortages = _all_shortages(streams, recording, times, damage)
    if damage and all(stream.is_full for stream in streams):
        shortages.append(f"{label} is damaged: {damage}; all wanted scans lie before that.")
    told = [
        (each.topic, remark) for each in streams for remark in sorted({cloud.remark for cloud in each.clouds} - {""})
    ]
    remarks = [*times.notes, *(f"'{topic}' {remark}." for topic, remark in told), *_clock_notes(streams)]
    is_spread = times.end_ns is not None and not times.is_dense  # scans between those that were taken are unknown
    span = recording.span_ns(topics) if is_spread else None
    rates_hz = {each.topic: _mean_rate_hz(counts[each.topic], span) if span else _rate_hz(each) for each in streams}
    remarks += _rate_notes(rates_hz)
    clouds = {
        stream.topic: tuple(sorted(stream.clouds, key=lambda cloud: cloud.scan.stamp_ns))
        for stream in streams
        if stream.clouds
    }
    unread = {stream.topic: [*stream.broken, *([] if clouds else stream.lost)] for stream in streams}
    return Window(
        clouds,
        {topic: sentences[0] for topic, sentences in unread.items() if sentences and topic not in clouds},
        (*faults, *shortages, *remarks),
        (*(shortages if damage else ()), *faults),
        {stream.topic: joined for stream in streams if (joined := stream.joined(label))},
    )


def require_frames(window: Window, topics: Mapping[str, str], config: IngestConfig, label: str) -> None:
    """Check that there is a frame, and one of every topic that was asked for by name.

    Args:
        topics: topic -> name of the LiDAR, as chosen.

    Raises:
        UnreadableSourceError: all frames are broken, or all of a topic that was asked for by name; with
            `config.strict`, any fault.
        UnfitSnapshotError: no frame lies in the window, or a topic holds the clouds of several LiDARs.
    """
    require_separate(window, topics)
    if config.strict and window.faults:
        raise UnreadableSourceError(f"{label} is refused, as ingest.strict is set: {window.faults[0]}")
    has_frames = bool(window.clouds.keys() & set(topics))
    named = named_topics(topics, config)
    for topic in sorted(topics):
        if topic in window.broken and (topic in named or not has_frames):
            raise UnreadableSourceError(window.broken[topic])
        if topic not in window.clouds and topic in named - {*config.only}:
            raise UnfitSnapshotError(f"{label} has no scan of '{topic}' after {config.start_s:g} s.")
    if not has_frames:
        raise UnfitSnapshotError(f"{label} has no readable scan after {config.start_s:g} s.")


def require_separate(window: Window, topics: Collection[str]) -> None:
    """Raise UnfitSnapshotError if one of the topics holds the clouds of several LiDARs."""
    for topic in sorted(window.joined.keys() & set(topics)):
        raise UnfitSnapshotError(window.joined[topic])


def _fill(streams: Mapping[str, TopicFrames], recording: Recording, times: TimeRange, frames: int) -> str:
    """Fill the streams; return why reading ended early or what is known to be missing."""
    messages = until_full(recording, streams, times.start_ns)
    if times.end_ns is not None:
        spread_ns = [times.start_ns] if times.is_dense else evenly(times.start_ns, times.end_ns, frames)
        most = frames if times.is_dense else 1
        messages = (message for _, message in sampled(recording, streams.keys(), spread_ns, times.end_ns, most))
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


def _all_shortages(streams: list[TopicFrames], recording: Recording, times: TimeRange, damage: str) -> list[str]:
    present = {stream.topic: stream.clouds for stream in streams if stream.clouds}
    begins_ns = [cloud.scan.log_time_ns for clouds in present.values() for cloud in clouds]
    start_ns = times.start_ns or min(begins_ns, default=0)
    notes: list[str] = []
    for stream in streams:
        is_missing = present and not (damage or stream.clouds or stream.broken or stream.lost)
        why = why_absent(recording, stream.topic, present, start_ns) if is_missing else ""
        notes += [f"'{stream.topic}' is left out: {why}."] if why else _shortages(stream, streams, damage)
    return notes


def _shortages(stream: TopicFrames, streams: list[TopicFrames], damage: str) -> list[str]:
    taken = len(stream.clouds)
    if damage and not stream.is_full:
        return [f"'{stream.topic}': {taken} of {stream.wanted} scans, then {damage}."]
    if stream.fell_silent:
        patience_s = PATIENCE_NS / 1e9
        if not taken:
            advice = "a later --start may have it"
            return [f"'{stream.topic}' is left out: no scan for {patience_s:.0f} s; {advice}."]
        return [f"'{stream.topic}' fell silent: {taken} of {stream.wanted} scans, then none for {patience_s:.0f} s."]
    if taken + len(stream.broken) < max(len(other.clouds) for other in streams):
        scans = "1 scan" if taken == 1 else f"{taken} scans"
        return [f"'{stream.topic}' has {scans} in the window, others have more."]
    return []


@dataclass(slots=True)
class TopicFrames:
    """The frames of one topic so far.

    Args:
        wanted: number of frames; broken ones do not count.
        clouds: in the order of the recording.
        broken: errors of the scans that cannot be decoded.
        lost: errors of damaged parts of the recording, with an unknown number of scans.
        offsets_s: log time minus stamp of each cloud that has both.
        repeated: scans that are equal to one before.
        backward: scans with a stamp before that of the previous one.
        fell_silent: True if reading of the topic ended before it was full.
    """

    topic: str
    wanted: int
    clouds: list[Cloud] = field(default_factory=list)
    broken: list[str] = field(default_factory=list)
    lost: list[str] = field(default_factory=list)
    offsets_s: list[float] = field(default_factory=list)
    repeated: int = 0
    backward: int = 0
    fell_silent: bool = False

    @property
    def is_full(self) -> bool:
        """True if there are enough frames, or too many broken ones to try more."""
        return len(self.clouds) >= self.wanted or len(self.broken) >= _MAX_BROKEN

    def take(self, message: RawMessage) -> None:
        """Decode and add a scan, unless there are enough."""
        if self.is_full or not is_cloud(message):
            return
        if message.fault:
            self.lost.append(f"{message.origin} {message.fault}.")
            return
        try:
            cloud = decode_cloud(message)
        except UnreadableSourceError as error:
            self.broken.append(str(error))
            return
        scan = cloud.scan
        if message.log_time_ns:
            if any(
                scan.stamp_ns == other.scan.stamp_ns and np.array_equal(scan.points_m, other.scan.points_m)
                for other in self.clouds
            ):
                self.repeated += 1
                return
            self.offsets_s.append((message.log_time_ns - scan.stamp_ns) / 1e9)
        self.backward += bool(self.clouds) and scan.stamp_ns < self.clouds[-1].scan.stamp_ns
        if len(scan.points_m) and not scan.points_m.any():
            # Zeros mean that no beam returned.
            scan = Scan(np.empty((0, 3), np.float32), scan.stamp_ns)
        memory_budget().take(scan.nbytes)
        self.clouds.append(replace(cloud, scan=replace(scan, log_time_ns=message.log_time_ns)))

    def joined(self, label: str) -> str:
        """Return a sentence if the clouds are of several LiDARs; empty if not."""
        devices = sorted({cloud.device or cloud.frame_id for cloud in self.clouds})
        frame_ids = [cloud.frame_id for cloud in self.clouds]
        # A frame may be renamed once; several LiDARs send in turn.
        changes = sum(one != other for one, other in pairwise(frame_ids))
        if len({cloud.device for cloud in self.clouds}) < 2 and changes <= max(1, len(set(frame_ids)) - 1):
            return ""
        return (
            f"In {label}, '{self.topic}' holds the clouds of {len(devices)} LiDARs ({', '.join(devices)}); expected a "
            "topic for each, as with `multi_topic: 1` of the Livox drivers: record it so, or choose others by --topic."
        )

    def faults(self) -> Iterator[str]:
        """Yield sentences on scans that cannot be used as they are."""
        taken = len(self.clouds)
        if self.broken:
            scans = f"{len(self.broken)} of {len(self.broken) + taken} scans of '{self.topic}'"
            yield f"{scans} are broken and left out: {self.broken[0]}"
        if self.lost:
            places = "1 place" if len(self.lost) == 1 else f"{len(self.lost)} places"
            yield f"'{self.topic}' has lost scans in {places}: {self.lost[0]}"
        if self.repeated:
            yield f"'{self.topic}' holds {self.repeated} scans twice; each was used once."
        if self.backward:
            yield f"'{self.topic}' has stamps that go backward; its scans were sorted."
        empty = sum(not len(cloud.scan.points_m) for cloud in self.clouds)
        if empty:
            yield f"'{self.topic}': {empty} of {taken} scans have no points, or only zeros."
        frame_ids = sorted({cloud.frame_id for cloud in self.clouds})
        if len(frame_ids) > 1:
            yield f"'{self.topic}' has scans in several frames ({', '.join(frame_ids)}), used as one."


def _clock_notes(streams: list[TopicFrames]) -> list[str]:
    """Return a note if the offsets between stamps and log times differ between topics."""
    offsets_s = {stream.topic: median(stream.offsets_s) for stream in streams if stream.offsets_s}
    if not offsets_s or max(offsets_s.values()) - min(offsets_s.values()) <= _MAX_CLOCK_OFFSET_S:
        return []
    listed = ", ".join(f"'{topic}' by {offset_s:.3f} s" for topic, offset_s in sorted(offsets_s.items()))
    return [f"The stamps lag behind the log time: {listed}; the frames were chosen by log time."]


def _mean_rate_hz(count: int, span: Span) -> float:
    return 1e9 * (count - 1) / (span[1] - span[0]) if count >= _LEAST_SCANS and span[1] > span[0] else 0.0


def _rate_hz(stream: TopicFrames) -> float:
    """Return how often scans follow each other that were taken one after the other; 0.0 if nothing tells."""
    if len(stream.clouds) < _LEAST_SCANS:
        return 0.0
    # Stamps that were never set, or log times of a recorder that writes in bursts, tell nothing.
    stamps = [cloud.scan.stamp_ns for cloud in stream.clouds]
    logged = [cloud.scan.log_time_ns for cloud in stream.clouds]
    period_ns = max(float(np.median(np.diff(sorted(times_ns)))) for times_ns in (stamps, logged))
    return 1e9 / period_ns if period_ns > 0.0 else 0.0


def _rate_notes(rates_hz: Mapping[str, float]) -> list[str]:
    """Return a note on topics whose scans follow each other faster than LiDARs turn, as single packets do."""
    fast = {f"'{topic}'": round(rate_hz) for topic, rate_hz in sorted(rates_hz.items()) if rate_hz > _MAX_RATE_HZ}
    if not fast:
        return []
    have, most = "has" if len(fast) == 1 else "have up to", max(fast.values())
    told = (
        f"{listed([*fast])} {have} {most} scans per second: they may be single packets, with a part of the view each; "
        f"let the driver send whole turns, or take all of a second with --frames {most}."
    )
    return [told]


def until_full(recording: Recording, streams: Mapping[str, TopicFrames], start_ns: int) -> Iterator[RawMessage]:
    """Yield messages from a time on until each stream is full or silent for `PATIENCE_NS`.

    Args:
        streams: by topic; the caller adds each message to its stream before it asks for the next one. Streams that
            were given up are marked with `fell_silent`.
    """
    last_ns: dict[str, int] = {}
    with closing(recording.messages(streams.keys(), start_ns)) as messages:
        for message in messages:
            now_ns = message.log_time_ns
            last_ns[message.topic] = now_ns
            lacking = [stream for topic, stream in streams.items() if not stream.is_full and topic != message.topic]
            silent = [stream for stream in lacking if now_ns - last_ns.setdefault(stream.topic, now_ns) > PATIENCE_NS]
            if len(silent) == len(lacking) and lacking and streams[message.topic].is_full:
                for stream in silent:
                    stream.fell_silent = True
                return
            yield message
