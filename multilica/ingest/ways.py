# SPDX-License-Identifier: Apache-2.0
"""The ways between the stops of a log: the motion of each LiDAR, by its frames on the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import pairwise

from multilica.errors import UnreadableSourceError
from multilica.ingest.message_types import decode_cloud
from multilica.ingest.recording import DamagedRecordingError, Recording, Span
from multilica.snapshot import LidarMotion

LONGEST_WAY_S = 60.0
"""After a longer way, stops hardly see anything in common, and odometry is off by too much."""
_NS_PER_S = 1_000_000_000
_STANDING_NS = 300_000_000
"""As much of the stops at both ends is read as well."""


def read_motions(
    recording: Recording, lidars: Mapping[str, str], stops: Sequence[Span]
) -> tuple[tuple[LidarMotion, ...], ...]:
    """Follow each LiDAR from stop to stop.

    One frame is held at a time, and none is decoded in which a LiDAR has hardly moved.

    Args:
        lidars: topic -> name.
        stops: log times, in order.

    Returns:
        Per stop, the motions since the previous one. There are none at the first stop, none after a way that takes
        longer than `LONGEST_WAY_S`, and none of a LiDAR that lost its track.
    """
    ways = [
        _follow(recording, lidars, before, after) if after[0] - before[1] <= LONGEST_WAY_S * _NS_PER_S else ()
        for before, after in pairwise(stops)
    ]
    return ((), *ways)


def _follow(recording: Recording, lidars: Mapping[str, str], before: Span, after: Span) -> tuple[LidarMotion, ...]:
    from multilica.registration.odometry import Odometer

    start_ns = max(before[0], before[1] - _STANDING_NS)
    end_ns = min(after[1], after[0] + _STANDING_NS)
    odometers = {topic: Odometer() for topic in lidars}
    try:
        with closing(recording.messages(lidars.keys(), start_ns)) as messages:
            for message in messages:
                time_ns = message.log_time_ns
                if time_ns > end_ns:
                    break
                odometer = odometers[message.topic]
                if odometer.needs(time_ns):
                    try:
                        odometer.add(decode_cloud(replace(message, timed=True)).scan, time_ns)
                    except UnreadableSourceError:
                        continue
    except DamagedRecordingError:
        pass
    return tuple(
        motion
        for topic, odometer in odometers.items()
        if odometer.covers(before[1], after[0]) and (motion := odometer.motion(lidars[topic])) is not None
    )
