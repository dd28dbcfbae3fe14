# SPDX-License-Identifier: Apache-2.0
"""The frames between the stops of a simulated drive: motions for the calibration, and the peer's hand-eye poses."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import pairwise

import numpy as np

from multilica.geometry import FloatArray
from multilica.registration.odometry import Odometer
from multilica.simulate import SimulatedDrive
from multilica.snapshot import LidarMotion, LidarScans, ReadMotions, Scan
from tests.bench.support.hand_eye import follow, hand_eye

_Span = tuple[int, int]


def ways_of(made: SimulatedDrive) -> dict[str, ReadMotions]:
    """Return what follows the LiDARs to each stop from the one before, by the name of the stop."""
    legs = enumerate(pairwise(made.spans_ns), start=2)
    return {f"stop {number}": partial(_motions, made, *leg) for number, leg in legs}


def offsets_of_hand_eye_m(made: SimulatedDrive, target: str) -> dict[str, FloatArray]:
    """Return by how much the peer's position (3,) of each LiDAR is off, in the target's frame."""
    assert made.log is not None
    motions = {lidar.name: _ways_by_kiss(made, lidar) for lidar in made.log.lidars}
    found = {name: hand_eye(motions[target], own) for name, own in motions.items() if name != target}
    return {name: pose[:3, 3] - made.truth.between(target, name).xyz_m for name, pose in found.items()}


def in_plane_mm(made: SimulatedDrive, target: str, offset_m: FloatArray) -> float:
    """Return the horizontal length of an offset (3,) in the target's frame: motions on a plane tell no height."""
    in_base = made.truth.T_target_source[target].rotate(offset_m[None])[0]
    return 1e3 * float(np.hypot(*in_base[:2]))


def _motions(made: SimulatedDrive, before: _Span, after: _Span) -> tuple[LidarMotion, ...]:
    assert made.log is not None
    found = []
    for lidar in made.log.lidars:
        odometer = Odometer()
        for scan in _between(lidar, before, after):
            if odometer.needs(scan.stamp_ns):
                odometer.add(scan, scan.stamp_ns)
        if (motion := odometer.motion(lidar.name)) is not None:
            found.append(motion)
    return tuple(found)


def _ways_by_kiss(made: SimulatedDrive, lidar: LidarScans) -> list[FloatArray]:
    legs = ([(scan.points_m, scan.times_ns) for scan in _between(lidar, *leg)] for leg in pairwise(made.spans_ns))
    return [follow(frames) for frames in legs]


def _between(lidar: LidarScans, before: _Span, after: _Span) -> Iterator[Scan]:
    """Yield the frames from the last one at a stop to the first one at the next."""
    return (scan for scan in lidar.scans if before[1] <= scan.stamp_ns <= after[0])
