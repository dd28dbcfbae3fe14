# SPDX-License-Identifier: Apache-2.0
"""Clouds of LiDARs after each stage, and matches between their surfaces."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated

from pydantic import Field

from multilica.geometry import Z_AXIS, Float32Array, FloatArray, RigidTransform
from multilica.results.registrations import Reason
from multilica.results.values import Figure, not_in_document

_ENOUGH_RETURNS = 20_000


@dataclass(frozen=True, slots=True)
class SensorHealth:
    """Findings about the sensor itself."""

    lidar: Annotated[str, *not_in_document("")]
    returns: Annotated[int, Field(description="Number of returns.")]
    near_share: Annotated[Figure, Field(description="Share of the returns that are nearer than the minimum range.")]
    blockage_ratio: Annotated[Figure, Field(description="Share of the field of view behind a dirty or covered window.")]
    reasons: Annotated[
        tuple[Reason, ...], Field(description="Reasons why the sensor is not trusted; empty if it is.")
    ] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PreprocessedCloud:
    """One LiDAR's returns after cleaning.

    Args:
        returns_m: (R, 3) every kept return in the LiDAR's own frame, as recorded: one beam each.
        points_m: (N, 3) the same, thinned on the voxel grid.
        dropped_m: per reason, the (K, 3) points that were dropped.
        health: None where the sensor was not examined.
        left_out: kept returns that `returns_m` lacks.
        elevation_axis: (3,) of the LiDAR's frame, about which its beams turn.
    """

    lidar: str
    returns_m: Float32Array
    points_m: FloatArray
    dropped_m: Mapping[str, FloatArray] = field(default_factory=dict)
    health: SensorHealth | None = None
    left_out: int = 0
    elevation_axis: FloatArray = field(default_factory=lambda: Z_AXIS)

    @property
    def returns(self) -> int:
        """Number of kept returns."""
        return len(self.returns_m) + self.left_out

    def slim(self) -> "PreprocessedCloud":
        """Keep only every nth return, enough to show the field of view: all of them take most of the memory."""
        every_nth = self.returns_m[:: max(1, len(self.returns_m) // _ENOUGH_RETURNS)]
        return replace(self, returns_m=every_nth.copy(), left_out=self.returns - len(every_nth))


@dataclass(frozen=True, slots=True, eq=False)
class FeatureCloud:
    """Descriptors of one LiDAR's thinned cloud.

    Args:
        points_m: (N, 3); normals: (N, 3) unit; descriptors: (N, 33) FPFH.
    """

    lidar: str
    points_m: FloatArray
    normals: FloatArray
    descriptors: FloatArray


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
