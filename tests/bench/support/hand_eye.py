# SPDX-License-Identifier: Apache-2.0
"""The usual peer on a drive: odometry of each LiDAR by KISS-ICP, then hand-eye calibration, without any registration.

It uses nothing of multilica. KISS-ICP is imported when frames are followed: `pip install kiss-icp`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

Matrix = npt.NDArray[np.float64]
Frame = tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32] | None]
"""Points (N, 3) in metres and their times (N,) in nanoseconds after the first one, or None."""

# The voxel of its defaults is 1 m; half of that is more accurate where a LiDAR sees little.
_VOXEL_M, _MAX_RANGE_M = 0.5, 100.0
_LEVER_M = 10.0
_HEADINGS = 8
# Keeps what the motions leave free, such as the height on a plane, where it started.
_FREE = 1e-3


def follow(frames: Sequence[Frame]) -> Matrix:
    """Return the pose (4, 4) of a LiDAR at its last frame in its own frame at the first one."""
    from kiss_icp.config import KISSConfig
    from kiss_icp.kiss_icp import KissICP

    config = KISSConfig()
    config.data.max_range, config.data.deskew = _MAX_RANGE_M, True
    config.mapping.voxel_size = _VOXEL_M
    config.registration.max_num_threads = 1
    odometry = KissICP(config)
    for points_m, times_ns in frames:
        shares = np.empty(0) if times_ns is None else times_ns / max(float(times_ns.max()), 1.0)
        odometry.register_frame(points_m.astype(np.float64), shares)
    return np.asarray(odometry.last_pose)


def hand_eye(target: Sequence[Matrix], source: Sequence[Matrix]) -> Matrix:
    """Return ``T_target_source`` (4, 4) for which both LiDARs have the same motions (4, 4), way by way.

    It solves A X = X B by least squares from several headings, rotations counted as arcs at 10 m.
    """

    def residuals(unknown: Matrix) -> Matrix:
        pose = _matrix(unknown)
        offs = [np.linalg.inv(one @ pose) @ pose @ other for one, other in zip(target, source, strict=True)]
        return np.concatenate([*map(_vector, offs), _FREE * unknown])

    starts = [np.array([0.0, 0.0, 2.0 * np.pi * heading / _HEADINGS, 0.0, 0.0, 0.0]) for heading in range(_HEADINGS)]
    found = [least_squares(residuals, start) for start in starts]
    return _matrix(min(found, key=lambda each: float(each.cost)).x)


def _matrix(vector: Matrix) -> Matrix:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(vector[:3]).as_matrix()
    pose[:3, 3] = vector[3:]
    return pose


def _vector(pose: Matrix) -> Matrix:
    return np.concatenate([_LEVER_M * Rotation.from_matrix(pose[:3, :3]).as_rotvec(), pose[:3, 3]])
