# SPDX-License-Identifier: Apache-2.0
"""Odometry of one LiDAR: its motion from frame to frame, by GICP with a map of what it saw before."""

from __future__ import annotations

import numpy as np
import small_gicp
from scipy.spatial.transform import Rotation

from multilica.geometry import FloatArray, RigidTransform, lengths, rotation_vector, skew
from multilica.snapshot import LidarMotion, Scan

# The vehicle's own body moves with the LiDAR; beyond, beams are too far apart to show a surface's orientation.
_NEAR_M, _FAR_M = 2.5, 80.0
_THIN_M, _MAP_M, _REACH_M = 0.3, 0.5, 2.0
_NEIGHBOURS, _ITERATIONS = 10, 30
_MIN_POINTS = 100
_NS_PER_S = 1e9
# A frame shows nothing new if the vehicle has moved by less since the last one, unless that was long ago.
_SAME_M, _SAME_RAD, _SAME_S = 0.1, float(np.deg2rad(1.0)), 0.15
# A longer gap leaves too much open.
_LOST_S = 1.0
# The motion of a vehicle changes by less from frame to frame.
_LOST_M, _LOST_RAD = 0.8, float(np.deg2rad(8.0))
_LOST_SHARE = 0.3
# Fitted to the errors on simulated drives: variance per frame and matched point, and share of the way.
_FRAME_VARIANCE = 0.025**2
_WAY_SHARE, _LEAST_M, _LEAST_RAD = 0.003, 0.01, float(np.deg2rad(0.15))
# The same where points have no times, so that frames are as skewed as the vehicle is fast.
_SKEWED_SHARE, _SKEWED_RAD = 0.03, float(np.deg2rad(1.0))


class Odometer:
    """Follows one LiDAR over the frames that it is given, in their order.

    It assumes that the motion of one frame goes on in the next, both for the start of the registration and for points
    that were measured one after the other. Memory is bounded: parts of the map that are out of sight go.
    """

    def __init__(self) -> None:
        self._map = small_gicp.GaussianVoxelMap(_MAP_M)
        self._pose = np.eye(4)
        self._velocity = np.zeros(6)
        self._covariance = np.zeros((6, 6))
        self._stamp_ns, self._taken_ns, self._begun_ns = 0, 0, 0
        self._way_m, self._frames = 0.0, 0
        self._is_lost, self._is_timed = False, True

    def needs(self, log_time_ns: int) -> bool:
        """Return whether a frame of that time is worth reading: the LiDAR has moved since the last one."""
        elapsed_s = (log_time_ns - self._taken_ns) / _NS_PER_S
        turn_rad, shift_m = lengths(self._velocity.reshape(2, 3)) * elapsed_s
        return not self._is_lost and (
            not self._frames or elapsed_s >= _SAME_S or turn_rad >= _SAME_RAD or shift_m >= _SAME_M
        )

    def add(self, scan: Scan, log_time_ns: int) -> None:
        """Register a frame with the map, and add it there."""
        elapsed_s = (scan.stamp_ns - self._stamp_ns) / _NS_PER_S
        if self._is_lost or (self._frames and elapsed_s <= 0.0):
            return
        if self._frames and elapsed_s > _LOST_S:
            self._is_lost = True
            return
        cloud = self._prepared(scan)
        if len(cloud.points()) < _MIN_POINTS:  # as frames that a driver lost
            return
        if self._frames:
            self._follow(cloud, elapsed_s)
        else:
            self._begun_ns = log_time_ns
        self._map.insert(cloud, self._pose)
        self._stamp_ns, self._taken_ns = scan.stamp_ns, log_time_ns
        self._frames += 1

    def covers(self, start_ns: int, end_ns: int) -> bool:
        """Return whether its frames begin at the first log time or before, and end at the second or after."""
        return self._frames > 0 and self._begun_ns <= start_ns and self._taken_ns >= end_ns

    def motion(self, lidar: str) -> LidarMotion | None:
        """Return the motion from the first frame to the last one; None if the LiDAR lost its track."""
        if self._is_lost or self._frames < 2:
            return None
        rotation = self._pose[:3, :3]
        along_target = np.kron(np.eye(2), rotation)
        covariance = along_target @ self._covariance @ along_target.T
        share, least_rad = (_WAY_SHARE, _LEAST_RAD) if self._is_timed else (_SKEWED_SHARE, _SKEWED_RAD)
        covariance += np.diag(np.repeat([least_rad**2, _LEAST_M**2 + (share * self._way_m) ** 2], 3))
        pose = RigidTransform.from_rotation_translation(lidar, lidar, rotation, self._pose[:3, 3])
        return LidarMotion(lidar, pose, covariance, self._way_m, self._frames)

    def _prepared(self, scan: Scan) -> small_gicp.PointCloud:
        """Return the points in range as they were in the middle of the frame, thinned, with covariances."""
        range_m = lengths(scan.points_m)
        kept = (range_m > _NEAR_M) & (range_m < _FAR_M)
        points_m = scan.points_m[kept].astype(np.float64)
        self._is_timed &= scan.times_ns is not None
        if scan.times_ns is not None and len(points_m):
            since_s = scan.times_ns[kept] / _NS_PER_S
            since_s -= 0.5 * (scan.times_ns.min() + float(scan.times_ns.max())) / _NS_PER_S
            turns = Rotation.from_rotvec(since_s[:, None] * self._velocity[:3])
            points_m = turns.apply(points_m) + since_s[:, None] * self._velocity[3:]
        cloud, _ = small_gicp.preprocess_points(points_m, _THIN_M, _NEIGHBOURS, 1)
        return cloud

    def _follow(self, cloud: small_gicp.PointCloud, elapsed_s: float) -> None:
        expected = self._pose @ _moved(self._velocity * elapsed_s)
        found = small_gicp.align(
            self._map,
            cloud,
            init_T_target_source=expected,
            max_correspondence_distance=_REACH_M,
            num_threads=1,
            max_iterations=_ITERATIONS,
        )
        off = np.linalg.inv(expected) @ found.T_target_source
        self._is_lost = bool(
            found.num_inliers < _LOST_SHARE * len(cloud.points())
            or np.linalg.norm(off[:3, 3]) > _LOST_M
            or np.linalg.norm(rotation_vector(off[:3, :3])) > _LOST_RAD
        )
        step = np.linalg.inv(self._pose) @ found.T_target_source
        rotation = step[:3, :3].T
        arm = skew(step[:3, 3])
        carried = np.block([[rotation, np.zeros((3, 3))], [-rotation @ arm, rotation]])
        information = found.H / max(found.num_inliers, 1)
        own = _FRAME_VARIANCE * np.linalg.inv(information + 1e-9 * np.eye(6))
        self._covariance = carried @ self._covariance @ carried.T + own
        self._velocity = np.concatenate([rotation_vector(step[:3, :3]), step[:3, 3]]) / elapsed_s
        self._way_m += float(np.linalg.norm(step[:3, 3]))
        self._pose = found.T_target_source


def _moved(twist: FloatArray) -> FloatArray:
    """Return a motion (4, 4) of a rotation vector and a translation (6,)."""
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(twist[:3]).as_matrix()
    motion[:3, 3] = twist[3:]
    return motion
