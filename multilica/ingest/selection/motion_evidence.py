# SPDX-License-Identifier: Apache-2.0
"""The motion of the vehicle by odometry, IMU or clouds."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from multilica.config import StillnessConfig
from multilica.errors import UnreadableSourceError
from multilica.geometry import FloatArray
from multilica.ingest.messages.cloud import decode_cloud, is_cloud
from multilica.ingest.messages.ros import deserialize
from multilica.ingest.recording import Recording, Span
from multilica.ingest.selection.sampling import PATIENCE_NS, evenly, sampled
from multilica.snapshot import Scan

if TYPE_CHECKING:
    from multilica.stages.stillness import Motion

Samples: TypeAlias = Sequence[tuple[int, bool | None]]
"""Log times in nanoseconds, and whether the vehicle stands still; None if unknown."""
Evidence: TypeAlias = tuple[str, Samples] | None
"""Name and samples; None if the recording has no such topic."""

_NS_PER_S = 1_000_000_000
_MAX_SAMPLES = 240
_MAX_CLOUD_SAMPLES = 90
_MIN_STEP_S = 0.25
_MIN_CLOUD_STEP_S = 1.0
_MAX_LIDARS = 4
"""LiDARs to try until one shows enough throughout."""

_MAX_SPEED_MPS = 0.05
_MAX_TURN_RAD_S = 0.01
_MAX_STEP_M = 0.05
"""Limits of odometry at standstill; the step is between the positions of two samples."""
_BURST = 20
_MAX_SHAKE_MPS2 = 0.3
_MIN_SHAKE_MPS2 = 0.05
_SHAKE_RATIO = 2.5
"""An idling engine shakes the body by 0.1 m/s2, a smooth road by more than 0.3."""


def by_odometry(recording: Recording, span: Span) -> Evidence:
    """Sample speed, turning rate and position of odometry."""
    samples = _ros_samples(recording, "nav_msgs/msg/Odometry", span, 1)
    if samples is None:
        return None
    topic, times_ns, bursts = samples
    rows = np.array([_odometry_row(messages[0]) for messages in bursts])
    finite = np.isfinite(rows).all(axis=1)
    steps_m = np.linalg.norm(np.diff(rows[:, 2:], axis=0, prepend=rows[:1, 2:]), axis=1)
    still = finite & (rows[:, 0] < _MAX_SPEED_MPS) & (rows[:, 1] < _MAX_TURN_RAD_S) & (steps_m < _MAX_STEP_M)
    return f"odometry on '{topic}'", list(zip(times_ns, still.tolist(), strict=True))


def by_imu(recording: Recording, span: Span) -> Evidence:
    """Sample the spread of accelerations and the turning rate within bursts of IMU messages."""
    samples = _ros_samples(recording, "sensor_msgs/msg/Imu", span, _BURST)
    if samples is None:
        return None
    topic, times_ns, bursts = samples
    shakes_mps2, turns_rad_s = np.array([_shake_and_turn(messages) for messages in bursts]).T
    calm_mps2 = _SHAKE_RATIO * float(np.nanpercentile(shakes_mps2, 10))
    still = (shakes_mps2 < min(_MAX_SHAKE_MPS2, max(_MIN_SHAKE_MPS2, calm_mps2))) & (turns_rad_s < 2 * _MAX_TURN_RAD_S)
    return f"the IMU on '{topic}'", list(zip(times_ns, still.tolist(), strict=True))


def by_clouds(recording: Recording, span: Span) -> Evidence:
    """Compare each sampled cloud of one LiDAR with the next frame and with the next sample.

    The LiDAR is the one with the largest clouds that show enough at all times, else at most times.
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
) -> tuple[str, list[int], list[list[Any]]] | None:
    """Return the topic with the most messages of a type, and log time and messages of each sample."""
    topics = [
        topic
        for topic in recording.topics
        if topic.message_type == message_type and topic.encoding in ("cdr", "ros1") and topic.count
    ]
    if not topics:
        return None
    name = max(topics, key=lambda topic: (topic.count, topic.name)).name
    bursts: dict[int, list[Any]] = defaultdict(list)
    logged_ns: dict[int, int] = {}
    for index, message in sampled(recording, [name], _times_ns(span, _MAX_SAMPLES, _MIN_STEP_S), span[1] + 1, most):
        if message.message_type != message_type:
            continue
        try:
            bursts[index].append(deserialize(message))
        except ValueError:
            continue
        logged_ns.setdefault(index, message.log_time_ns)
    order = sorted(logged_ns)
    return (name, [logged_ns[index] for index in order], [bursts[index] for index in order]) if order else None


def _times_ns(span: Span, most: int, min_step_s: float) -> list[int]:
    count = int((span[1] - span[0]) / _NS_PER_S / min_step_s) + 1
    return evenly(span[0], span[1] + 1, min(most, count))


def _odometry_row(message: Any) -> FloatArray:  # noqa: ANN401 - the class is made by rosbags at run time
    """Return speed, turning rate and position (5,)."""
    twist, position = message.twist.twist, message.pose.pose.position
    return np.array([np.linalg.norm(_xyz(twist.linear)), np.linalg.norm(_xyz(twist.angular)), *_xyz(position)])


def _shake_and_turn(messages: Sequence[Any]) -> tuple[float, float]:
    """Return the spread of accelerations and the largest turning rate."""
    accelerations = np.array([_xyz(message.linear_acceleration) for message in messages])
    rates = np.array([_xyz(message.angular_velocity) for message in messages])
    return float(np.linalg.norm(accelerations.std(axis=0))), float(np.abs(rates.mean(axis=0)).max())


def _xyz(vector: Any) -> list[float]:  # noqa: ANN401 - see _odometry_row
    return [vector.x, vector.y, vector.z]


def _richest_topics(recording: Recording, span: Span) -> list[str]:
    """Return the cloud topics, those with the largest clouds first."""
    topics = [topic.name for topic in recording.topics if is_cloud(topic) and topic.count]
    sizes = dict.fromkeys(topics, 0)
    # Do not wait for topics that are silent at the beginning.
    for _, message in sampled(recording, topics, [span[0]], min(span[1], span[0] + PATIENCE_NS) + 1):
        sizes[message.topic] = len(message.data)
    return sorted(sizes, key=lambda topic: (-sizes[topic], topic))
