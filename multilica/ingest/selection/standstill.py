# SPDX-License-Identifier: Apache-2.0
"""The times in which the vehicle stands still, by whatever shows it."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, TypeAlias, TypeVar

import numpy as np

from multilica.config import StillnessConfig
from multilica.errors import UnreadableSourceError
from multilica.geometry import FloatArray
from multilica.ingest.message_types import decode_cloud, is_cloud
from multilica.ingest.messages.ros import WireReader
from multilica.ingest.recording import DamagedRecordingError, ProgressObserver, RawMessage, Recording, Span
from multilica.ingest.selection.sampling import PATIENCE_NS, evenly, sampled
from multilica.snapshot import Scan

if TYPE_CHECKING:
    from multilica.stages.stillness import Motion

_Item = TypeVar("_Item")
_NS_PER_S = 1_000_000_000
# LiDARs are sampled at their first frames after the same times.
_SAME_TIME_NS = 300_000_000
_MIN_STANDSTILL_NS = 10**9
"""A vehicle that turns round stands still for less."""

_Samples: TypeAlias = Sequence[tuple[int, bool | None]]
"""Log times in nanoseconds, and whether the vehicle stands still; None if unknown."""
_Found: TypeAlias = tuple[str, _Samples, int]
"""Name, samples, and the longest time between two of them, in nanoseconds, for which they tell."""
_Evidence: TypeAlias = _Found | None
"""None if the recording has no such topic."""

_Look: TypeAlias = Callable[[Recording, Span, ProgressObserver], _Evidence]

_ODOMETRY, _IMU = "nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu"

_MAX_SPEED_MPS = 0.05
_MAX_TURN_RAD_S = 0.01
_MAX_STEP_M = 0.05
"""Limits of odometry at standstill; the step is between the positions of two samples."""
_MAX_SHAKE_MPS2 = 0.3
_MIN_SHAKE_MPS2 = 0.05
_SHAKE_RATIO = 2.5
"""An idling engine shakes the body by 0.1 m/s2, a smooth road by more than 0.3."""
_G_MPS2 = 9.81
_LEAST_G, _MOST_G = 0.5, 2.0
"""Mean accelerations in between are gravity in g; without gravity, they are nearly 0."""
_BESIDE_NS = 3 * 10**9
"""By which the times before and after a sample of standstill that stands alone are looked at, too."""
_MOST_LONE = 8
_SHORT_NS = 2 * _BESIDE_NS + _MIN_STANDSTILL_NS
"""Up to this length, times are sampled twice as densely."""


@dataclass(frozen=True, slots=True)
class Standstills:
    """When the vehicle stands still.

    Args:
        evidence: what shows it.
        spans: log times of the first and the last sample of each standstill, oldest first.
        is_known: some samples show standstill or motion.
        is_whole: no sample shows motion; the only span is that which was asked for.
    """

    evidence: str
    spans: tuple[Span, ...]
    is_known: bool = True
    is_whole: bool = False


def untold(done: int, total: int) -> None:
    """Tell nobody about the progress."""
    del done, total


def find_standstills(recording: Recording, span: Span, observe: ProgressObserver = untold) -> Standstills:
    """Find all times of at least a second, or the whole span, of standstill.

    Only a few hundred samples are read, whatever the length of the recording. Motion between two of them is left to
    the check of the frames. In a damaged recording, samples end where it cannot be read.

    Args:
        observe: called with each sample; from the beginning again if other messages are looked at.
    """
    look, (name, samples, gap_ns) = _best_evidence(recording, span, observe)
    is_whole = all(still for _, still in samples) and _covers(samples, gap_ns, span)
    if is_whole or (not samples and has_single_frames(recording)):
        return Standstills(name, (span,), is_known=bool(samples), is_whole=True)
    runs = list(_runs(samples, gap_ns))
    lone = [run for run in runs if run[1] - run[0] < _MIN_STANDSTILL_NS][:_MOST_LONE]
    runs += [found for run in lone for found in _around(recording, look, run, span)]
    kept = sorted({run for run in runs if run[1] - run[0] >= _MIN_STANDSTILL_NS})
    return Standstills(name, tuple(kept), is_known=any(still is not None for _, still in samples))


def _best_evidence(recording: Recording, span: Span, observe: ProgressObserver) -> tuple[_Look, _Found]:
    """Return the most direct evidence that tells of the whole span, and shows standstill as well as motion.

    Odometry that always says the same may come from a node without data, or be noisy at rest; if clouds tell
    nothing, it counts.
    """
    second_best: tuple[_Look, _Found] | None = None
    for look in (_by_odometry, _by_imu):
        found = look(recording, span, observe)
        if found is not None and _covers(*found[1:], span):
            if len({still for _, still in found[1]}) > 1:
                return look, found
            second_best = second_best or (look, found)
    clouds = _by_clouds(recording, span, observe)
    if second_best is not None and all(still is None for _, still in clouds[1]):
        return second_best
    return _by_clouds, clouds


def _covers(samples: _Samples, gap_ns: int, span: Span) -> bool:
    """Return whether samples tell of a whole span: a node may start late, or die."""
    times_ns = [span[0], *(time_ns for time_ns, _ in samples), span[1]]
    return bool(samples) and all(after - before <= gap_ns for before, after in pairwise(times_ns))


def _runs(samples: _Samples, gap_ns: int) -> Iterator[Span]:
    """Yield the standstills; where samples are missing, nothing shows that one goes on."""
    begin = end = None
    for time_ns, still in samples:
        if begin is not None and end is not None and not (still and time_ns - end <= gap_ns):
            yield begin, end
            begin = None
        if still:
            begin, end = time_ns if begin is None else begin, time_ns
    if begin is not None and end is not None:
        yield begin, end


def _around(recording: Recording, look: _Look, run: Span, span: Span) -> list[Span]:
    """Return the standstill about a lone sample."""
    near = (max(span[0], run[0] - _BESIDE_NS), min(span[1], run[1] + _BESIDE_NS))
    found = look(recording, near, untold)
    runs = _runs(*found[1:]) if found else ()
    return [each for each in runs if each[0] <= run[1] and run[0] <= each[1]]


def has_single_frames(recording: Recording) -> bool:
    """Return whether no LiDAR has a second frame."""
    counts: Counter[str] = Counter()
    for topic in filter(is_cloud, recording.topics):
        counts[topic.name] += topic.count
    return max(counts.values(), default=0) == 1


def _by_odometry(recording: Recording, span: Span, observe: ProgressObserver) -> _Evidence:
    """Sample speed, turning rate and position of odometry."""
    samples = _ros_samples(recording, _ODOMETRY, span, 1, observe)
    if samples is None:
        return None
    topic, times_ns, bursts, gap_ns = samples
    rows = np.array([[*map(np.linalg.norm, (row[43:46], row[46:49])), *row[:3]] for (row, *_) in bursts])
    finite = np.isfinite(rows).all(axis=1)
    steps_m = np.linalg.norm(np.diff(rows[:, 2:], axis=0, prepend=rows[:1, 2:]), axis=1)
    still = finite & (rows[:, 0] < _MAX_SPEED_MPS) & (rows[:, 1] < _MAX_TURN_RAD_S) & (steps_m < _MAX_STEP_M)
    return f"odometry on '{topic}'", list(zip(times_ns, still.tolist(), strict=True)), gap_ns


def _by_imu(recording: Recording, span: Span, observe: ProgressObserver) -> _Evidence:
    """Sample the spread of accelerations and the turning rate within bursts of IMU messages."""
    samples = _ros_samples(recording, _IMU, span, 20, observe)
    if samples is None:
        return None
    topic, times_ns, bursts, gap_ns = samples
    imu = [np.array(rows) for rows in bursts]
    gravity = float(np.nanmedian([np.linalg.norm(rows[:, 25:28].mean(axis=0)) for rows in imu]))
    to_mps2 = _G_MPS2 if _LEAST_G < gravity < _MOST_G else 1.0  # some drivers give g
    shakes_mps2 = to_mps2 * np.array([np.linalg.norm(rows[:, 25:28].std(axis=0)) for rows in imu])
    turns_rad_s = np.array([np.abs(rows[:, 13:16].mean(axis=0)).max() for rows in imu])
    calm_mps2 = _SHAKE_RATIO * float(np.nanpercentile(shakes_mps2, 10))
    still = (shakes_mps2 < min(_MAX_SHAKE_MPS2, max(_MIN_SHAKE_MPS2, calm_mps2))) & (turns_rad_s < 2 * _MAX_TURN_RAD_S)
    return f"the IMU on '{topic}'", list(zip(times_ns, still.tolist(), strict=True)), gap_ns


def _by_clouds(recording: Recording, span: Span, observe: ProgressObserver) -> _Found:
    """Compare each sampled cloud of one LiDAR with the next frame and with the next sample.

    The LiDAR is the one with the largest clouds that show enough at all times, else at most times. One that is silent
    for a part of the recording shows nothing then. At times at which it does not show whether the vehicle stands,
    others may.
    """
    found: list[tuple[float, str, _Samples, int]] = []
    for topic in richest_topics(recording, span)[:4]:
        samples, times_ns = _cloud_samples(recording, topic, span, observe)
        # The last one may have no second frame.
        known = min(1.0, sum(still is not None for _, still in samples) / max(1, len(times_ns) - 1))
        found.append((known, topic, samples, _gap_ns(times_ns)))
        if known == 1.0:
            break
    _, topic, samples, gap_ns = best = max(found, key=lambda each: each[0])
    told = sorted(each for other in found if other is not best for each in other[2] if each[1] is not None)
    return (
        f"the clouds on '{topic}'",
        [each if each[1] is not None else _told(each[0], told) for each in samples],
        gap_ns,
    )


def _told(time_ns: int, others: _Samples) -> tuple[int, bool | None]:
    """Return what other LiDARs tell of a time: the vehicle stands if one of them shows that, and none a motion."""
    near = [still for at_ns, still in others if abs(at_ns - time_ns) < _SAME_TIME_NS]
    return time_ns, all(near) if near else None


def _cloud_samples(
    recording: Recording, topic: str, span: Span, observe: ProgressObserver
) -> tuple[_Samples, list[int]]:
    """Return the samples of a LiDAR, and the times at which one has them that is never silent."""
    # Slow LiDARs have no two frames in half a second.
    for step_s in (0.5, 1.0) if span[1] - span[0] <= _SHORT_NS else (1.0,):
        times_ns = _times_ns(span, 90, step_s)
        if samples := _cloud_samples_at(recording, topic, times_ns, span[1], observe):
            break
    return samples, times_ns


def _cloud_samples_at(
    recording: Recording, topic: str, times_ns: Sequence[int], end_ns: int, observe: ProgressObserver
) -> _Samples:
    from multilica.stages.stillness import detect_motion

    scans: dict[int, list[Scan]] = defaultdict(list)
    logged_ns: dict[int, int] = {}
    still: list[tuple[int, bool | None]] = []
    config = StillnessConfig()
    previous: Scan | None = None
    # Clouds fill chunks fast, so even jumps within a second save reading.
    for index, message in _readable(sampled(recording, [topic], times_ns, end_ns + 1, most=2, jump_ns=0)):
        observe(index + 1, len(times_ns))
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


def _readable(items: Iterable[_Item]) -> Iterator[_Item]:
    """Yield up to where the recording is damaged."""
    try:
        yield from items
    except DamagedRecordingError:
        return


def _stands(motion: Motion) -> bool | None:
    return not motion.moving if motion.observable else None


def _ros_samples(
    recording: Recording, message_type: str, span: Span, most: int, observe: ProgressObserver
) -> tuple[str, list[int], list[list[FloatArray]], int] | None:
    """Return the topic with the most messages of a type; time and messages of each sample, as numbers; and the gap."""
    topics = [
        topic
        for topic in recording.topics
        if topic.message_type == message_type and topic.encoding in ("cdr", "ros1") and topic.count
    ]
    if not topics:
        return None
    name = max(topics, key=lambda topic: (topic.count, topic.name)).name
    bursts: dict[int, tuple[int, list[FloatArray]]] = {}
    times_ns = _times_ns(span, 240, 0.25)
    for index, message in _readable(sampled(recording, [name], times_ns, span[1] + 1, most)):
        observe(index + 1, len(times_ns))
        if message.message_type != message_type:
            continue
        try:
            numbers = _numbers(message)
        except ValueError:
            continue
        bursts.setdefault(index, (message.log_time_ns, []))[1].append(numbers)
    found = [bursts[index] for index in sorted(bursts)]
    return (name, [time_ns for time_ns, _ in found], [rows for _, rows in found], _gap_ns(times_ns)) if found else None


def _times_ns(span: Span, most: int, min_step_s: float) -> list[int]:
    count = int((span[1] - span[0]) / _NS_PER_S / min_step_s) + 1
    return evenly(span[0], span[1] + 1, min(most, count))


def _gap_ns(times_ns: Sequence[int]) -> int:
    """Return the longest time between two samples of such times: one may be missing, and messages be a second apart."""
    step_ns = times_ns[1] - times_ns[0] if len(times_ns) > 1 else 0
    return 3 * step_ns + _NS_PER_S


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


def richest_topics(recording: Recording, span: Span) -> list[str]:
    """Return the cloud topics, those with the largest clouds first."""
    topics = [topic.name for topic in recording.topics if is_cloud(topic) and topic.count]
    sizes = dict.fromkeys(topics, 0)
    # Do not wait for topics that are silent at the beginning.
    for _, message in _readable(sampled(recording, topics, [span[0]], min(span[1], span[0] + PATIENCE_NS) + 1)):
        sizes[message.topic] = len(message.data)
    return sorted(sizes, key=lambda topic: (-sizes[topic], topic))
