# SPDX-License-Identifier: Apache-2.0
"""Logs of drives from few frames."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from multilica.simulate import RIGS, SimulatedDrive
from multilica.simulate.rigs import FRONT_BACK
from multilica.simulate.sensors import RasterPattern
from multilica.snapshot import Snapshot

_FRAME_NS = 100_000_000


@contextmanager
def small_rig() -> Iterator[None]:
    """Add the rig `small`: two LiDARs of a few thousand beams, front and rear."""
    coarse = RasterPattern(36, 160, 120.0, 25.0)
    mounts = tuple(replace(mount, sensor=replace(mount.sensor, pattern=coarse)) for mount in FRONT_BACK.mounts)
    with pytest.MonkeyPatch.context() as patched:
        patched.setitem(RIGS, "small", replace(FRONT_BACK, name="small", mounts=mounts))
        yield


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
