# SPDX-License-Identifier: Apache-2.0
"""Odometry, IMU and clouds as witnesses of whether the vehicle moves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from multilica.config import StillnessConfig
from multilica.errors import UnreadableSourceError
from multilica.geometry import FloatArray
from multilica.ingest.cloud import decode_cloud, is_cloud
from multilica.ingest.recording import Recording, Span
from multilica.ingest.ros_messages import unpacked
from multilica.ingest.sampling import PATIENCE_NS, evenly, sampled
from multilica.snapshot import Scan

if TYPE_CHECKING:
    from multilica.stages.stillness import Motion

__all__ = ["Samples", "Witness", "by_clouds", "by_imu", "by_odometry"]

Samples: TypeAlias = Sequence[tuple[int, bool | None]]
"""Log times, and whether the vehicle stands still then; None: it cannot be told."""
Witness: TypeAlias = tuple[str, Samples] | None
"""Who says so, and what; None: nothing to go by."""

_NS_PER_S = 1_000_000_000
_MAX_SAMPLES = 240
_MAX_CLOUD_SAMPLES = 90
_MIN_STEP_S = 0.25
_MIN_CLOUD_STEP_S = 1.0
_MAX_LIDARS = 4
"""That are asked, one after the other, until one can tell throughout."""

_MAX_SPEED_MPS = 0.05
_MAX_TURN_RAD_S = 0.01
_MAX_STEP_M = 0.05
"""Odometry that stands still says so to within these; poses of two samples differ by no more."""
_BURST = 20
_MAX_SHAKE_MPS2 = 0.3
_MIN_SHAKE_MPS2 = 0.05
_SHAKE_RATIO = 2.5
"""An engine that idles shakes the body by 0.1 m/s2, a smooth road by more than 0.3."""

_ODOMETRY = ("nav_msgs/msg/Odometry",)
_IMU = ("sensor_msgs/msg/Imu",)


def by_odometry(recording: Recording, span: Span) -> Witness:
    """Speed and turning rate as odometry tells them, and how far its positions lie apart."""
    samples = _ros_samples(recording, _ODOMETRY, span, 1)
    if samples is None:
        return None
    topic, bursts = samples
    rows = np.array([_odometry_row(messages[0]) for _, messages in bursts])
    finite = np.isfinite(rows).all(axis=1)
    steps_m = np.linalg.norm(np.diff(rows[:, 2:], axis=0, prepend=rows[:1, 2:]), axis=1)
    still = finite & (rows[:, 0] < _MAX_SPEED_MPS) & (rows[:, 1] < _MAX_TURN_RAD_S) & (steps_m < _MAX_STEP_M)
    return f"odometry on '{topic}'", list(zip([time_ns for time_ns, _ in bursts], still.tolist(), strict=True))


def by_imu(recording: Recording, span: Span) -> Witness:
    """How much the body shakes and turns within bursts of some samples."""
    samples = _ros_samples(recording, _IMU, span, _BURST)
    if samples is None:
        return None
    topic, bursts = samples
    shakes_mps2, turns_rad_s = np.array([_shake_and_turn(messages) for _, messages in bursts]).T
    calm_mps2 = _SHAKE_RATIO * float(np.nanpercentile(shakes_mps2, 10))
    still = (shakes_mps2 < min(_MAX_SHAKE_MPS2, max(_MIN_SHAKE_MPS2, calm_mps2))) & (turns_rad_s < 2 * _MAX_TURN_RAD_S)
    return f"the IMU on '{topic}'", list(zip([time_ns for time_ns, _ in bursts], still.tolist(), strict=True))


def by_clouds(recording: Recording, span: Span) -> Witness:
    """Whether each sampled cloud of one LiDAR lies where the next frame, and the next sample, have it.

    The LiDAR is the one with the largest clouds that can tell throughout, else the one that can at most times.
    """
    found: list[tuple[float, str, Samples]] = []
    for topic in _richest_topics(recording, span)[:_MAX_LIDARS]:
        samples = _cloud_samples(recording, topic, span)
        known = np.mean([still is not None for _, still in samples]) if samples else 0.0
        found.append((float(known), topic, samples))
        if known == 1.0:
            break
    _, topic, samples = max(found, key=lambda each: each[0])
    return f"the clouds on '{topic}'", samples


def _cloud_samples(recording: Recording, topic: str, span: Span) -> Samples:
    from multilica.stages.stillness import detect_motion

    times_ns = _times_ns(span, _MAX_CLOUD_SAMPLES, _MIN_CLOUD_STEP_S)
    scans: dict[int, list[Scan]] = defaultdict(list)
    logged_ns: dict[int, int] = {}
    still: list[tuple[int, bool | None]] = []
    config = StillnessConfig()
    previous: Scan | None = None
    # Clouds of all LiDARs fill chunks fast: even within a second, some need not be read.
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
                # A stretch may begin with a sample to which the vehicle has just come.
                still += [] if stayed else [(logged_ns[index] - 1, stayed)]
            still.append((logged_ns[index], alone))
            previous = scans.pop(index)[0]
    return still


def _stands(motion: Motion) -> bool | None:
    return not motion.moving if motion.can_tell else None


def _ros_samples(
    recording: Recording, types: Sequence[str], span: Span, most: int
) -> tuple[str, list[tuple[int, list[Any]]]] | None:
    """The topic with the most messages of these types; log time and messages of each sample."""
    topics = [
        topic
        for topic in recording.topics
        if topic.message_type in types and topic.encoding in ("cdr", "ros1") and topic.count
    ]
    if not topics:
        return None
    name = max(topics, key=lambda topic: (topic.count, topic.name)).name
    bursts: dict[int, list[Any]] = defaultdict(list)
    logged_ns: dict[int, int] = {}
    for index, message in sampled(recording, [name], _times_ns(span, _MAX_SAMPLES, _MIN_STEP_S), span[1] + 1, most):
        try:
            bursts[index].append(unpacked(message))
        except ValueError:
            continue
        logged_ns.setdefault(index, message.log_time_ns)
    return (name, [(logged_ns[index], bursts[index]) for index in sorted(logged_ns)]) if logged_ns else None


def _times_ns(span: Span, most: int, min_step_s: float) -> list[int]:
    count = int((span[1] - span[0]) / _NS_PER_S / min_step_s) + 1
    return evenly(span[0], span[1] + 1, min(most, count))


def _odometry_row(message: Any) -> FloatArray:  # noqa: ANN401 - the class is made by rosbags at run time
    """Speed, turning rate, and position."""
    twist, position = message.twist.twist, message.pose.pose.position
    return np.array([np.linalg.norm(_xyz(twist.linear)), np.linalg.norm(_xyz(twist.angular)), *_xyz(position)])


def _shake_and_turn(messages: Sequence[Any]) -> tuple[float, float]:
    """Spread of the acceleration, largest turning rate."""
    accelerations = np.array([_xyz(message.linear_acceleration) for message in messages])
    rates = np.array([_xyz(message.angular_velocity) for message in messages])
    return float(np.linalg.norm(accelerations.std(axis=0))), float(np.abs(rates.mean(axis=0)).max())


def _xyz(vector: Any) -> list[float]:  # noqa: ANN401 - see _odometry_row
    return [vector.x, vector.y, vector.z]


def _richest_topics(recording: Recording, span: Span) -> list[str]:
    """Those with the largest clouds first."""
    topics = [topic.name for topic in recording.topics if is_cloud(topic) and topic.count]
    sizes = dict.fromkeys(topics, 0)
    # One that is silent at the beginning is not waited for.
    for _, message in sampled(recording, topics, [span[0]], min(span[1], span[0] + PATIENCE_NS) + 1):
        sizes[message.topic] = len(message.data)
    return sorted(sizes, key=lambda topic: (-sizes[topic], topic))
