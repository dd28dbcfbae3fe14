# SPDX-License-Identifier: Apache-2.0
"""Points of LiDARs on surfaces that other LiDARs measured."""

from __future__ import annotations

from dataclasses import dataclass

from multilica.geometry import FloatArray, RigidTransform


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceMatches:
    """Nearest neighbours of a pair's clouds, as GICP matches them, at the pair's final pose.

    Args:
        T_target_source: that of the rig if it places both LiDARs, else that of the pair's registration.
        target_points_m, source_points_m: (K, 3), row i of both is match i, each in its own LiDAR's frame.
        distance_m: (K,) between the two points, which includes the spacing of the clouds.
        plane_distance_m: (K,) of the source point from the plane through the surroundings of the target point.
    """

    target: str
    source: str
    T_target_source: RigidTransform
    target_points_m: FloatArray
    source_points_m: FloatArray
    distance_m: FloatArray
    plane_distance_m: FloatArray

    def __len__(self) -> int:
        return len(self.distance_m)


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceResiduals:
    """Residual of the merged cloud at a LiDAR's points that other LiDARs saw as well.

    Args:
        points_m: (N, 3) in the LiDAR's frame.
        residual_m: (N,) distance to the nearest plane of another LiDAR that an accepted pair links to it.
    """

    lidar: str
    points_m: FloatArray
    residual_m: FloatArray
