# SPDX-License-Identifier: Apache-2.0
"""Poses of one LiDAR over the logs of its vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform, read_only

IndexArray = npt.NDArray[np.int64]

TO_LENGTHS = np.array([LEVER_ARM_M] * 3 + [1.0] * 3)
"""Factors (6,) that turn an offset (rotation rad, translation m) into six lengths in metres."""


@dataclass(frozen=True, slots=True, eq=False)
class LidarSeries:
    """The poses of one LiDAR of one vehicle, one per log, in order of time.

    Args:
        keys: of the logs (N,).
        time_ns: (N,) since the epoch, ascending; two logs may have one time.
        T_target_lidar: (N,) poses.
        covariances: (N, 6, 6) as reported, order rotation (rad), translation (m), along the target's axes.

    Raises:
        ValueError: lengths differ, times descend, a covariance is not finite, or a frame is not the series'.
    """

    vehicle: str
    lidar: str
    target: str
    keys: tuple[str, ...]
    time_ns: IndexArray
    T_target_lidar: tuple[RigidTransform, ...]
    covariances: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "time_ns", read_only(self.time_ns, np.int64))
        object.__setattr__(self, "covariances", read_only(self.covariances, np.float64))
        count = len(self.keys)
        shapes = self.time_ns.shape, (len(self.T_target_lidar),), self.covariances.shape
        if shapes != ((count,), (count,), (count, 6, 6)):
            raise ValueError(f"expected {count} times, poses and 6x6 covariances, found shapes {shapes}")
        if np.any(np.diff(self.time_ns) < 0):
            raise ValueError(f"the logs of {self.vehicle} are not in order of time")
        if not np.all(np.isfinite(self.covariances)):
            raise ValueError(f"a covariance of {self.lidar} of {self.vehicle} is not finite")
        if any((pose.target, pose.source) != (self.target, self.lidar) for pose in self.T_target_lidar):
            raise ValueError(f"a pose of {self.lidar} of {self.vehicle} is in other frames")

    def __len__(self) -> int:
        return len(self.keys)

    def offsets(self, reference: RigidTransform) -> FloatArray:
        """Return the offsets (N, 6) from a pose as lengths in metres: rotation times lever arm, translation."""
        rows = [pose.offset_from(reference) for pose in self.T_target_lidar]
        return np.asarray(np.array(rows).reshape(-1, 6) * TO_LENGTHS)

    def scaled_covariances(self) -> FloatArray:
        """Return the covariances (N, 6, 6) of these offsets, in square metres."""
        return np.asarray(self.covariances * np.outer(TO_LENGTHS, TO_LENGTHS))
