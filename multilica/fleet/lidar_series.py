# SPDX-License-Identifier: Apache-2.0
"""Poses of one LiDAR over the logs of its vehicle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from multilica.fleet.store.query import ask
from multilica.fleet.store.store import Store
from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform, read_only

IndexArray = npt.NDArray[np.int64]

TO_LENGTHS = np.array([LEVER_ARM_M] * 3 + [1.0] * 3)
"""Factors (6,) that turn an offset (rotation rad, translation m) into six lengths in metres."""
_UNKNOWN_COVARIANCE = (np.nan,) * 36
_MOST_COMPARED = 1000
_ROWS = """
SELECT vehicle, lidar, target, CASE WHEN time < TIMESTAMPTZ '2262-01-01' THEN epoch_ns(time) END AS time_ns, key,
       source, how = 'calibrated', status = 'uncertain', [x_m, y_m, z_m], [qx, qy, qz, qw], covariance
FROM lidars WHERE lidar <> target ORDER BY vehicle, lidar, target, time NULLS LAST, key
"""


@dataclass(frozen=True, slots=True, eq=False)
class LidarSeries:
    """The poses of one LiDAR of one vehicle, one per log, in order of time.

    Args:
        keys: of the logs with a pose (N,).
        time_ns: (N,) since the epoch, ascending; two logs may have one time.
        T_target_lidar: (N,) poses.
        covariances: (N, 6, 6) as reported, order rotation (rad), translation (m), along the target's axes; NaN where
            they are not known.
        sources: (N,) names of the logs; empty if not known.
        calibrated, uncertain: indices of the poses that were calibrated, not verified, and of the uncertain ones.
        missing_ns: (M,) times of the logs without a pose.
        undated: number of the logs without a time, which are not in the arrays.

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
    sources: tuple[str, ...] = ()
    calibrated: frozenset[int] = frozenset()
    uncertain: frozenset[int] = frozenset()
    missing_ns: IndexArray = field(default_factory=lambda: np.empty(0, np.int64))
    undated: int = 0

    def __post_init__(self) -> None:
        for name, kind in (("time_ns", np.int64), ("missing_ns", np.int64), ("covariances", np.float64)):
            object.__setattr__(self, name, read_only(getattr(self, name), kind))
        count = len(self.keys)
        shapes = self.time_ns.shape, (len(self.T_target_lidar),), self.covariances.shape
        if shapes != ((count,), (count,), (count, 6, 6)):
            raise ValueError(f"expected {count} times, poses and 6x6 covariances, found shapes {shapes}")
        if np.any(np.diff(self.time_ns) < 0):
            raise ValueError(f"the logs of {self.vehicle} are not in order of time")
        unknown = np.isnan(self.covariances).all(axis=(1, 2))
        if not np.all(np.isfinite(self.covariances[~unknown])):
            raise ValueError(f"a covariance of {self.lidar} of {self.vehicle} is not finite")
        if any((pose.target, pose.source) != (self.target, self.lidar) for pose in self.T_target_lidar):
            raise ValueError(f"a pose of {self.lidar} of {self.vehicle} is in other frames")

    def __len__(self) -> int:
        return len(self.keys)

    def with_known_covariances(self) -> LidarSeries:
        """Return the logs whose covariance is known, as keys, times, poses and covariances."""
        known = np.flatnonzero(~np.isnan(self.covariances[:, 0, 0]))
        keys, poses = tuple(self.keys[index] for index in known), tuple(self.T_target_lidar[index] for index in known)
        return LidarSeries(
            self.vehicle, self.lidar, self.target, keys, self.time_ns[known], poses, self.covariances[known]
        )

    def offsets(self, reference: RigidTransform) -> FloatArray:
        """Return the offsets (N, 6) from a pose as lengths in metres: rotation times lever arm, translation."""
        rows = [pose.offset_from(reference) for pose in self.T_target_lidar]
        return np.asarray(np.array(rows).reshape(-1, 6) * TO_LENGTHS)

    def scaled_covariances(self) -> FloatArray:
        """Return the covariances (N, 6, 6) of these offsets, in square metres."""
        return np.asarray(self.covariances * np.outer(TO_LENGTHS, TO_LENGTHS))

    def offsets_from_median(self) -> FloatArray:
        """Return offsets (N, 6) from the median pose: shift (mm), then rotation (deg), along the target's axes."""
        if not len(self):
            return np.empty((0, 6))
        xyz_m = np.array([pose.xyz_m for pose in self.T_target_lidar])
        rotations = Rotation.from_matrix([pose.rotation for pose in self.T_target_lidar])
        # The middle rotation is the one closest to all others, which no few outliers move.
        quaternions = rotations.as_quat()[:: 1 + len(self) // _MOST_COMPARED]
        angles_rad = np.arccos(np.abs(quaternions @ quaternions.T).clip(max=1.0))
        middle = Rotation.from_quat(quaternions[int(np.argmin(angles_rad.sum(axis=0)))])
        turns_rad = (rotations * middle.inv()).as_rotvec()
        turns_rad -= np.median(turns_rad, axis=0)
        return np.hstack([1e3 * (xyz_m - np.median(xyz_m, axis=0)), np.rad2deg(turns_rad)])

    def sigmas(self) -> FloatArray:
        """Return the standard deviations (N, 6) of these offsets (mm, deg); NaN where they are not known."""
        deviations = np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2).clip(min=0.0))
        return np.hstack([1e3 * deviations[:, 3:], np.rad2deg(deviations[:, :3])])


def read_series(store: Store) -> Iterator[LidarSeries]:
    """Yield the poses of each LiDAR of each vehicle, relative to each target that its logs have."""
    with ask(store, _ROWS) as answer:
        for (vehicle, lidar, target), group in groupby(answer.rows(), key=lambda row: row[:3]):
            yield _series(vehicle, lidar, target, [row[3:] for row in group])


def _series(vehicle: str, lidar: str, target: str, rows: Sequence[tuple[Any, ...]]) -> LidarSeries:
    dated = [row for row in rows if row[0] is not None]
    posed = [row for row in dated if row[5][0] is not None]
    times_ns, keys, sources, calibrated, uncertain, xyz_m, quaternions, covariances = (
        zip(*posed, strict=True) if posed else ((),) * 8
    )
    known = [each if each and len(each) == 36 else _UNKNOWN_COVARIANCE for each in covariances]
    return LidarSeries(
        vehicle,
        lidar,
        target,
        tuple(keys),
        np.array(times_ns, dtype=np.int64),
        tuple(
            RigidTransform.from_xyz_quaternion(target, lidar, *pose) for pose in zip(xyz_m, quaternions, strict=True)
        ),
        np.array(known, dtype=np.float64).reshape(-1, 6, 6),
        tuple(sources),
        frozenset(np.flatnonzero(calibrated).tolist()),
        frozenset(np.flatnonzero(uncertain).tolist()),
        np.array([row[0] for row in dated if row[5][0] is None], dtype=np.int64),
        len(rows) - len(dated),
    )
