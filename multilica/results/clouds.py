# SPDX-License-Identifier: Apache-2.0
"""Clouds of single LiDARs after each stage."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from multilica.geometry import FloatArray
from multilica.results.registrations import Reason

__all__ = ["FeatureCloud", "PreprocessedCloud", "SensorHealth"]


@dataclass(frozen=True, slots=True)
class SensorHealth:
    """Condition of a LiDAR, derived from its returns.

    Args:
        returns: finite returns over all frames.
        near_share: share of them that is too near to use: the vehicle's body, or dirt.
        soiled_share: share of the field of view that ends on the window.
        reasons: `dead` or `dirty`; none for a healthy LiDAR.
    """

    lidar: str
    returns: int
    near_share: float
    soiled_share: float
    reasons: tuple[Reason, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PreprocessedCloud:
    """One LiDAR's returns after cleaning.

    Args:
        returns_m: (R, 3) every kept return in the LiDAR's own frame: one beam each.
        points_m: (N, 3) the same, thinned on the voxel grid.
        dropped_m: per reason, the (K, 3) points that were dropped.
        health: None where the sensor was not examined.
    """

    lidar: str
    returns_m: FloatArray
    points_m: FloatArray
    dropped_m: Mapping[str, FloatArray] = field(default_factory=dict)
    health: SensorHealth | None = None


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
