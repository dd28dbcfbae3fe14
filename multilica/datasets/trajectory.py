# SPDX-License-Identifier: Apache-2.0
"""The path of a LiDAR through the world."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from multilica.errors import UnreadableSourceError
from multilica.geometry import FloatArray, RigidTransform

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
