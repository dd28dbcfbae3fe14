# SPDX-License-Identifier: Apache-2.0
"""Moments at which a vehicle that drives around stands still."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from multilica.config import StillnessConfig
from multilica.datasets.trajectory import Stamps, Trajectory
from multilica.geometry import FloatArray
from multilica.snapshot import Scan
from multilica.stages.stillness import detect_motion

ScanReader = Callable[[Iterable[int]], Sequence[Scan]]
"""A function that reads the scans of those stamps."""
_LOOKS_EVERY_NS = 2_000_000_000
"""A stop that matters is longer than this."""


def stops_by_poses(trajectory: Trajectory, length_ns: int) -> list[int]:
    """Find the stops at which the poses stay within the limits of `StillnessConfig` for that long.

    Returns:
        A start stamp per stop, from its middle, the longest stop first.
    """
    limits = StillnessConfig()
    stamps_ns = trajectory.stamps_ns
    still = stamps_ns + length_ns <= stamps_ns[-1]
    still[:-1] &= np.diff(stamps_ns) <= length_ns  # in a gap, nothing is known
    for step in range(1, len(stamps_ns)):
        span_ns = stamps_ns[step:] - stamps_ns[:-step]
        inside = span_ns <= length_ns
        if not inside.any():
            break
        shift_m: FloatArray = np.linalg.norm(trajectory.xyz_m[step:] - trajectory.xyz_m[:-step], axis=1)
        turn_rad = (trajectory.rotations[:-step].inv() * trajectory.rotations[step:]).magnitude()
        moved = (shift_m > limits.max_shift_m) | (turn_rad > np.deg2rad(limits.max_rotation_deg))
        still[:-step] &= ~(inside & moved)
    return _middles(stamps_ns, still)


def stops_by_scans(stamps_ns: Stamps, read: ScanReader, length_ns: int) -> list[int]:
    """Find the stops at which the scans of one LiDAR show no motion for that long, by looking every two seconds.

    Returns:
        A start stamp per stop, from its middle, the longest stop first.
    """
    starts, still = [], []
    next_ns = int(stamps_ns[0])
    for start_ns in map(int, stamps_ns):
        inside = stamps_ns[(stamps_ns >= start_ns) & (stamps_ns <= start_ns + length_ns)]
        if start_ns < next_ns or len(inside) < 2:
            continue
        next_ns = start_ns + _LOOKS_EVERY_NS
        motion = detect_motion(read(map(int, inside[[0, len(inside) // 2, -1]])), StillnessConfig())
        starts.append(start_ns)
        still.append(motion.observable and not motion.moving)
    return _middles(np.array(starts, np.int64), np.array(still, bool))


def _middles(stamps_ns: Stamps, still: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> list[int]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    stops = [(int(first), int(last) - 1) for first, last in edges.reshape(-1, 2)]
    stops.sort(key=lambda stop: (int(stamps_ns[stop[0]] - stamps_ns[stop[1]]), stop))
    return [int(stamps_ns[(first + last) // 2]) for first, last in stops]
