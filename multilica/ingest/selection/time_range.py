# SPDX-License-Identifier: Apache-2.0
"""The time range that frames are taken from: as configured, or where the vehicle stands still."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from datetime import UTC, datetime
from itertools import groupby
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from multilica.config import IngestConfig, StillnessConfig
from multilica.errors import ConfigError, UnfitSnapshotError, UnreadableSourceError
from multilica.geometry import FloatArray
from multilica.ingest.message_types import decode_cloud, is_cloud
from multilica.ingest.messages.ros import WireReader
from multilica.ingest.recording import RawMessage, Recording, Span
from multilica.snapshot import Scan

if TYPE_CHECKING:
    from multilica.stages.stillness import Motion

_NS_PER_S = 1_000_000_000
_MAX_SPREAD_S = 30.0
_MIN_NANOSECONDS = 10**17
"""Larger numbers are nanoseconds since the epoch (this is 1973), smaller ones seconds."""
_MIN_STANDSTILL_NS = 10**9
"""A vehicle that turns round stands still for less."""

_Samples: TypeAlias = Sequence[tuple[int, bool | None]]
"""Log times in nanoseconds, and whether the vehicle stands still; None if unknown."""
_Evidence: TypeAlias = tuple[str, _Samples] | None
"""Name and samples; None if the recording has no such topic."""

_ODOMETRY, _IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"

_MAX_SPEED_MPS = 0.05
_MAX_TURN_RAD_S = 0.01
_MAX_STEP_M = 0.05
"""Limits of odometry at standstill; the step is between the positions of two samples."""
_MAX_SHAKE_MPS2 = 0.3
_MIN_SHAKE_MPS2 = 0.05
_SHAKE_RATIO = 2.5
"""An idling engine shakes the body by 0.1 m/s2, a smooth road by more than 0.3."""

PATIENCE_NS = 10 * 10**9
"""Drivers that start one after the other have started by then; later, the vehicle may be somewhere else."""
_MIN_JUMP_NS = 2 * 10**9
"""Nearer messages lie in the same or the next chunk, where reading on is as fast as a jump."""


@dataclass(frozen=True, slots=True)
class TimeRange:
    """A range of log times; frames are spread up to `end_ns`, or taken one after the other if it is None."""

    start_ns: int = 0
    end_ns: int | None = None
    notes: tuple[str, ...] = ()


def find_time_range(recording: Recording, config: IngestConfig, label: str) -> TimeRange:
    """Return the configured time range.

    Raises:
        ConfigError: a time is not valid, or two beginnings are given.
        UnfitSnapshotError: the recording ends before it, or the vehicle never stands still.
    """
    if config.start_at and config.start_s:
        raise ConfigError("Found both ingest.start_s and ingest.start_at; expected one of them.")
    if not (config.start_at or config.start_s or config.window_s or config.window == "auto"):
        return TimeRange()
    span = recording.span_ns({topic.name for topic in recording.topics if is_cloud(topic)})
    if span is None:
        key = next(key for key in ("start_at", "start_s", "window_s", "window") if getattr(config, key))
        return TimeRange(notes=(f"Point files have no time: ingest.{key} has no effect.",))
    start_ns = _start_ns(span, config, label)
    if config.window == "auto":
        return _still_range(recording, config, start_ns, span, label)
    if not config.window_s:
        return TimeRange(start_ns)
    end_ns = start_ns + round(config.window_s * _NS_PER_S)
    if end_ns <= span[1]:
        return TimeRange(start_ns, end_ns)
    left_s = (span[1] - start_ns) / _NS_PER_S
    note = f"The recording ends {left_s:.1f} s after the window begins; frames are spread over that time."
    return TimeRange(start_ns, span[1] + 1, (note,))


def parse_time_ns(text: str) -> int:
    """Parse ISO 8601, or seconds or nanoseconds since the epoch, to nanoseconds; raise ConfigError for others."""
    if text.isdecimal() and int(text) >= _MIN_NANOSECONDS:
        return int(text)
    try:
        return round(float(text) * _NS_PER_S)
    except (ValueError, OverflowError):
        pass
    try:
        time = datetime.fromisoformat(text)
    except ValueError as error:
        raise ConfigError(
            f"Cannot read the time '{text}' in ingest.start_at; expected ISO 8601, as in 2026-05-04T12:30:00Z, "
            "or seconds or nanoseconds since the epoch."
        ) from error
    since_epoch = (time if time.tzinfo else time.replace(tzinfo=UTC)) - datetime.fromtimestamp(0, UTC)
    return (since_epoch.days * 86400 + since_epoch.seconds) * _NS_PER_S + since_epoch.microseconds * 1000


def _start_ns(span: Span, config: IngestConfig, label: str) -> int:
    if config.start_at:
        start_ns = parse_time_ns(config.start_at)
        if not span[0] - _NS_PER_S <= start_ns <= span[1]:
            raise UnfitSnapshotError(
                f"{label} has no point cloud at {config.start_at}: they span {_utc(span[0])} to {_utc(span[1])}; "
                "set ingest.start_at (--start) to a time between."
            )
        return start_ns
    duration_s = (span[1] - span[0]) / _NS_PER_S
    if config.start_s > duration_s:
        raise UnfitSnapshotError(
            f"{label} has no point cloud {config.start_s:g} s after its first one: they span {duration_s:.3f} s; "
            "set ingest.start_s (--start) to less."
        )
    return span[0] + round(config.start_s * _NS_PER_S)


def _still_range(recording: Recording, config: IngestConfig, start_ns: int, span: Span, label: str) -> TimeRange:
    first_ns, last_ns, evidence = _standstill(recording, (start_ns, span[1]), label)
    if _has_single_frames(recording):
        return TimeRange(start_ns, notes=("There is one frame per LiDAR, so no standstill to choose.",))
    longest_s = config.window_s or _MAX_SPREAD_S
    end_ns = min(last_ns, first_ns + round(longest_s * _NS_PER_S))
    first_s, last_s = ((time_ns - span[0]) / _NS_PER_S for time_ns in (first_ns, last_ns))
    note = f"The vehicle stands still from {first_s:.1f} to {last_s:.1f} s by {evidence}; frames are from there."
    return TimeRange(first_ns, end_ns, (note,))


def _has_single_frames(recording: Recording) -> bool:
    counts: Counter[str] = Counter()
    for topic in filter(is_cloud, recording.topics):
        counts[topic.name] += topic.count
    return max(counts.values(), default=0) == 1


def _standstill(recording: Recording, span: Span, label: str) -> tuple[int, int, str]:
    """Return the longest time of at least a second, or the whole span, of standstill, and what shows it.

    Only a few hundred samples are read, whatever the length of the recording. Motion between two of them is left to
    the check of the frames.
    """
    # The most direct evidence first.
    name, samples = next(
        found for look in (_by_odometry, _by_imu, _by_clouds) if (found := look(recording, span)) is not None
    )
    if (samples and all(still for _, still in samples)) or (not samples and _has_single_frames(recording)):
        return *span, name
    runs = [[time_ns for time_ns, _ in run] for still, run in groupby(samples, key=lambda s: s[1]) if still]
    longest = max(runs, key=lambda run: run[-1] - run[0], default=[0])
    if longest[-1] - longest[0] >= _MIN_STANDSTILL_NS:
        return longest[0], longest[-1], name
    if any(still is not None for _, still in samples):
        raise UnfitSnapshotError(
            f"In {label} the vehicle never stands still, by {name}; expected a second or more of standstill."
        )
    raise UnfitSnapshotError(
        f"In {label} nothing shows when the vehicle stands still: there is no readable odometry or IMU, and {name} "
        "show too little, as in a tunnel; choose a time with --start (ingest.start_s)."
    )


def _utc(time_ns: int) -> str:
    try:
        return datetime.fromtimestamp(time_ns / _NS_PER_S, UTC).isoformat(timespec="milliseconds")
    except (ValueError, OverflowError):
        return f"{time_ns / _NS_PER_S:.3f} s"


def _by_odometry(recording: Recording, span: Span) -> _Evidence:
    """Sample speed, turning rate and position of odometry."""
    samples = _ros_samples(recording, _ODOMETRY, span, 1)
    if samples is None:
        return None
    topic, times_ns, bursts = samples
    rows = np.array([[*map(np.linalg.norm, (row[43:46], row[46:49])), *row[:3]] for (row, *_) in bursts])
    finite = np.isfinite(rows).all(axis=1)
    steps_m = np.linalg.norm(np.diff(rows[:, 2:], axis=0, prepend=rows[:1, 2:]), axis=1)
    still = finite & (rows[:, 0] < _MAX_SPEED_MPS) & (rows[:, 1] < _MAX_TURN_RAD_S) & (steps_m < _MAX_STEP_M)
    return f"odometry on '{topic}'", list(zip(times_ns, still.tolist(), strict=True))


def _by_imu(recording: Recording, span: Span) -> _Evidence:
    """Sample the spread of accelerations and the turning rate within bursts of IMU messages."""
    samples = _ros_samples(recording, _IMU, span, 20)
    if samples is None:
        return None
    topic, times_ns, bursts = samples
    imu = [np.array(rows) for rows in bursts]
    shakes_mps2 = np.array([np.linalg.norm(rows[:, 25:28].std(axis=0)) for rows in imu])
    turns_rad_s = np.array([np.abs(rows[:, 13:16].mean(axis=0)).max() for rows in imu])
    calm_mps2 = _SHAKE_RATIO * float(np.nanpercentile(shakes_mps2, 10))
    still = (shakes_mps2 < min(_MAX_SHAKE_MPS2, max(_MIN_SHAKE_MPS2, calm_mps2))) & (turns_rad_s < 2 * _MAX_TURN_RAD_S)
    return f"the IMU on '{topic}'", list(zip(times_ns, still.tolist(), strict=True))


def _by_clouds(recording: Recording, span: Span) -> _Evidence:
    """Compare each sampled cloud of one LiDAR with the next frame and with the next sample.

    The LiDAR is the one with the largest clouds that show enough at all times, else at most times.
    """
    found: list[tuple[float, str, _Samples]] = []
    for topic in _richest_topics(recording, span)[:4]:
        samples = _cloud_samples(recording, topic, span)
        known = np.mean([still is not None for _, still in samples]) if samples else 0.0
        found.append((float(known), topic, samples))
        if known == 1.0:
            break
    _, topic, samples = max(found, key=lambda each: each[0])
    return f"the clouds on '{topic}'", samples


def _cloud_samples(recording: Recording, topic: str, span: Span) -> _Samples:
    from multilica.stages.stillness import detect_motion

    times_ns = _times_ns(span, 90, 1.0)
    scans: dict[int, list[Scan]] = defaultdict(list)
    logged_ns: dict[int, int] = {}
    still: list[tuple[int, bool | None]] = []
    config = StillnessConfig()
    previous: Scan | None = None
    # Clouds fill chunks fast, so even jumps within a second save reading.
    for index, message in sampled(recording, [topic], times_ns, span[1] + 1, most=2, jump_ns=0):
        try:
            scans[index].append(decode_cloud(message).scan)
        except UnreadableSourceError:
            continue
        logged_ns.setdefault(index, message.log_time_ns)
        if len(scans[index]) == 2:
            alone = _stands(detect_motion(scans[index], config))
            if alone and previous is not None:
                stayed = _stands(detect_motion([previous, scans[index][0]], config))
                # Standstill may begin with a sample that the vehicle has just arrived at.
                still += [] if stayed else [(logged_ns[index] - 1, stayed)]
            still.append((logged_ns[index], alone))
            previous = scans.pop(index)[0]
    return still


def _stands(motion: Motion) -> bool | None:
    return not motion.moving if motion.observable else None


def _ros_samples(
    recording: Recording, message_type: str, span: Span, most: int
) -> tuple[str, list[int], list[list[FloatArray]]] | None:
    """Return the topic with the most messages of a type, and log time and the messages' numbers of each sample."""
    topics = [
        topic
        for topic in recording.topics
        if topic.message_type == message_type and topic.encoding in ("cdr", "ros1") and topic.count
    ]
    if not topics:
        return None
    name = max(topics, key=lambda topic: (topic.count, topic.name)).name
    bursts: dict[int, tuple[int, list[FloatArray]]] = {}
    for index, message in sampled(recording, [name], _times_ns(span, 240, 0.25), span[1] + 1, most):
        if message.message_type != message_type:
            continue
        try:
            numbers = _numbers(message)
        except ValueError:
            continue
        bursts.setdefault(index, (message.log_time_ns, []))[1].append(numbers)
    found = [bursts[index] for index in sorted(bursts)]
    return (name, [time_ns for time_ns, _ in found], [rows for _, rows in found]) if found else None


def _times_ns(span: Span, most: int, min_step_s: float) -> list[int]:
    count = int((span[1] - span[0]) / _NS_PER_S / min_step_s) + 1
    return evenly(span[0], span[1] + 1, min(most, count))


def _numbers(message: RawMessage) -> FloatArray:
    """Return the numbers of a message in their order.

    Odometry (85,): position, quaternion, covariance (36), velocity, rates, covariance (36).
    IMU (37,): quaternion, covariance (9), rates, covariance (9), acceleration, covariance (9).
    """
    reader = WireReader.of_message(message)
    reader.header()
    if message.message_type == _IMU:
        return np.array(reader.float64s(37))
    reader.text()  # child_frame_id
    return np.array(reader.float64s(85))


def _richest_topics(recording: Recording, span: Span) -> list[str]:
    """Return the cloud topics, those with the largest clouds first."""
    topics = [topic.name for topic in recording.topics if is_cloud(topic) and topic.count]
    sizes = dict.fromkeys(topics, 0)
    # Do not wait for topics that are silent at the beginning.
    for _, message in sampled(recording, topics, [span[0]], min(span[1], span[0] + PATIENCE_NS) + 1):
        sizes[message.topic] = len(message.data)
    return sorted(sizes, key=lambda topic: (-sizes[topic], topic))


def evenly(start_ns: int, end_ns: int, count: int) -> list[int]:
    """Return the beginnings of `count` equal parts of a time range."""
    return [start_ns + (end_ns - start_ns) * index // count for index in range(count)]


def sampled(
    recording: Recording,
    topics: Collection[str],
    times_ns: Sequence[int],
    end_ns: int,
    most: int = 1,
    jump_ns: int = _MIN_JUMP_NS,
) -> Iterator[tuple[int, RawMessage]]:
    """Yield the index of each time and, per topic, the first messages from then on and before the next time.

    In an indexed recording, wait `PATIENCE_NS` for a silent topic rather than until the next time.

    Args:
        times_ns: log times, ascending; `end_ns` is the end of the last one's messages, exclusive.
        most: messages per time and topic.
        jump_ns: if the times are farther apart than this, skip what lies between.
    """
    if recording.is_indexed and len(times_ns) > 1 and times_ns[1] - times_ns[0] > jump_ns:
        for index, (start_ns, until_ns) in enumerate(zip(times_ns, [*times_ns[1:], end_ns], strict=True)):
            for _, message in sampled(recording, topics, [start_ns], min(until_ns, start_ns + PATIENCE_NS), most):
                yield index, message
        return
    taken: Counter[tuple[int, str]] = Counter()
    with closing(recording.messages(topics, times_ns[0])) as messages:
        for message in messages:
            if message.log_time_ns >= end_ns:
                return
            index = bisect_right(times_ns, message.log_time_ns) - 1
            taken[index, message.topic] += 1
            if taken[index, message.topic] <= most:
                yield index, message
            if index == len(times_ns) - 1 and all(taken[index, topic] >= most for topic in topics):
                return
