# SPDX-License-Identifier: Apache-2.0
"""The ways between the stops of a log: the motion of each LiDAR, by its frames on the way."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import replace

from multilica.config import IngestConfig
from multilica.errors import UnreadableSourceError
from multilica.ingest.locate import find_source
from multilica.ingest.memory import limited_memory
from multilica.ingest.message_types import decode_cloud
from multilica.ingest.metadata import config_for
from multilica.ingest.opening import open_source
from multilica.ingest.recording import DamagedRecordingError, Recording, Span
from multilica.ingest.remote.remote_file import SourceFile
from multilica.snapshot import LidarMotion

LONGEST_WAY_S = 60.0
"""After a longer way, stops hardly see anything in common, and odometry is off by too much."""
_NS_PER_S = 1_000_000_000
_STANDING_NS = 300_000_000
"""As much of the stops at both ends is read as well."""


def read_motions(
    paths: Sequence[SourceFile],
    lidars: Mapping[str, str],
    before: Span,
    after: Span,
    *,
    config: IngestConfig | None = None,
) -> tuple[LidarMotion, ...]:
    """Follow each LiDAR from one stop of a log to the next.

    One frame is held at a time, and none is decoded in which a LiDAR has hardly moved.

    Args:
        lidars: topic -> name.
        before, after: log times of the stops.

    Returns:
        None of a LiDAR that lost its track, and none at all of a way that takes longer than `LONGEST_WAY_S`.
    """
    if after[0] - before[1] > LONGEST_WAY_S * _NS_PER_S:
        return ()
    found = find_source(paths)
    config = config or config_for(found.files)
    with limited_memory(config.max_memory_mb, found.label), closing(open_source(found)) as recording:
        return _follow(recording, lidars, before, after)


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
