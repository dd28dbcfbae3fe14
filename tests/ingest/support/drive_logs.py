# SPDX-License-Identifier: Apache-2.0
"""Logs of drives from few frames."""

from dataclasses import replace

from multilica.simulate import SimulatedDrive
from multilica.snapshot import Snapshot

_FRAME_NS = 100_000_000


def log_of_stops(drive: SimulatedDrive, frames: int = 25, gap_s: float = 3.0) -> Snapshot:
    """Repeat the first frame of each stop; nothing is recorded on the way."""
    stop_ns = frames * _FRAME_NS + round(gap_s * 1e9)
    return replace(
        drive.snapshots[0],
        lidars=tuple(
            replace(
                lidar,
                scans=tuple(
                    replace(
                        snapshot[lidar.name].scans[0],
                        stamp_ns=lidar.scans[0].stamp_ns + index * stop_ns + number * _FRAME_NS,
                    )
                    for index, snapshot in enumerate(drive.snapshots)
                    for number in range(frames)
                ),
            )
            for lidar in drive.snapshots[0].lidars
        ),
    )
