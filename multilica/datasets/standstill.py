# SPDX-License-Identifier: Apache-2.0
"""The path of a LiDAR through the world, and the moments at which its vehicle stands still."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from multilica.config import StillnessConfig
from multilica.errors import UnreadableSourceError
from multilica.geometry import FloatArray, RigidTransform
from multilica.snapshot import Scan
from multilica.stages.stillness import detect_motion

Stamps = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Poses ``T_world_<lidar>``, oldest first.

    Args:
        stamps_ns: (N,) increasing.
        xyz_m: (N, 3).
        rotations: N of them.
    """

    lidar: str
    stamps_ns: Stamps
    xyz_m: FloatArray
    rotations: Rotation

    def pose_at(self, stamp_ns: int) -> RigidTransform | None:
        """Interpolate ``T_world_<lidar>``; None before the first and after the last pose."""
        if not self.stamps_ns[0] <= stamp_ns <= self.stamps_ns[-1]:
            return None
        # Relative to the stamp: nanoseconds since 1970 exceed the precision of a float.
        after = int(np.clip(np.searchsorted(self.stamps_ns, stamp_ns), 1, len(self.stamps_ns) - 1))
        two = slice(after - 1, after + 1)
        times = (self.stamps_ns[two] - stamp_ns).astype(np.float64)
        xyz_m = [float(np.interp(0.0, times, axis)) for axis in self.xyz_m[two].T]
        rotation = Slerp(times, self.rotations[two])(0.0)
        return RigidTransform.from_rotation_translation("world", self.lidar, rotation.as_matrix(), xyz_m)


def read_trajectory(path: Path, lidar: str) -> Trajectory:
    """Read lines ``stamp_ns x y z qx qy qz qw``.

    Raises:
        UnreadableSourceError: another layout, fewer than two poses, or stamps that do not increase.
    """
    try:
        return _parse(path.read_text(encoding="ascii"), lidar)
    except (OSError, OverflowError, ValueError) as error:
        found = " ".join(str(error).split()).rstrip(".")
        raise UnreadableSourceError(
            f"{path} is not a trajectory ({found}); expected lines of stamp in ns, x, y, z, qx, qy, qz, qw."
        ) from error


def _parse(text: str, lidar: str) -> Trajectory:
    """Parse a trajectory; raise ValueError or OverflowError with what was found."""
    lines = [line.split() for line in text.splitlines() if line.strip()]
    stamps_ns = np.array([int(words[0]) for words in lines], np.int64)
    values = np.array([[float(word) for word in words[1:8]] for words in lines], np.float64)
    if values.ndim != 2 or values.shape[0] < 2 or values.shape[1] != 7 or not np.isfinite(values).all():
        raise ValueError(f"{len(lines)} lines that are not poses")
    if not np.all(np.diff(stamps_ns) > 0):
        raise ValueError("time stamps that do not increase")
    return Trajectory(lidar, stamps_ns, values[:, :3], Rotation.from_quat(values[:, 3:]))


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
