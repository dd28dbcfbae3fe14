# SPDX-License-Identifier: Apache-2.0
"""Placements of LiDARs and of the ground."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results.hypotheses import PairKey
from multilica.results.registrations import Registration

__all__ = ["ContestedPlace", "GroundPlane", "LidarPlacement", "PlacementStatus", "SigmaOrigin", "Spread"]

PlacementStatus = Literal["placed", "uncertain", "not_placed"]
"""Uncertain: one pose stands alone and uncontradicted, but its standard deviation is above the limit."""

SigmaOrigin = Literal["residuals", "snapshots"]
"""What a covariance rests on: the residuals of the registrations, or those widened to the spread over snapshots."""


@dataclass(frozen=True, slots=True, eq=False)
class GroundPlane:
    """The ground seen from the target LiDAR.

    Args:
        normal: (3,) unit, upwards, in the target frame.
        offset_m: ``normal @ p + offset_m == 0`` on the plane, so the target LiDAR's height above ground.
        T_base_target: roll, pitch and z of the target LiDAR in an ISO 8855 base frame on the ground below it; x, y and
            yaw are zero.
        inlier_share: share of the merged cloud that lies on the plane.
    """

    normal: FloatArray
    offset_m: float
    T_base_target: RigidTransform
    inlier_share: float


@dataclass(frozen=True, slots=True, eq=False)
class Spread:
    """Scatter of a LiDAR's pose over the snapshots of one rig.

    Args:
        snapshots: number of snapshots that place it.
        xyz_m, rotation_deg: (3,) sample standard deviations along and about the target's axes; None below two.
    """

    snapshots: int
    xyz_m: FloatArray | None = None
    rotation_deg: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ContestedPlace:
    """Two accepted pairs that put one LiDAR at different places.

    Args:
        pair, other: (target, source) of the pairs, the one with more evidence first.
        distance_m, angle_rad: between the two places.
        competing: the pose of `pair` that follows from `other`, scored but not registered; None where verification is
            off.
    """

    pair: PairKey
    other: PairKey
    distance_m: float
    angle_rad: float
    competing: Registration | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LidarPlacement:
    """The pose of one LiDAR, or why it has none.

    Args:
        status: both `placed` and `uncertain` LiDARs have a pose.
        covariance: (6, 6) of the pose, order rotation (rad), translation (m), both along the target's axes.
        T_target_source_prior: the pose that the prior claims; None where it lacks the LiDAR or the target.
        sigma_from: what the covariance rests on.
        spread: over the snapshots of a joint result; None where there is only one snapshot.
        contested: why accepted pairs did not place it; None where no two contradict each other.
    """

    lidar: str
    reason: str
    status: PlacementStatus = "not_placed"
    T_target_source: RigidTransform | None = None
    fitness: float = 0.0
    rmse_m: float = float("inf")
    covariance: FloatArray | None = None
    T_target_source_prior: RigidTransform | None = None
    sigma_from: SigmaOrigin = "residuals"
    spread: Spread | None = None
    contested: ContestedPlace | None = None

    @property
    def placed(self) -> bool:
        """Whether it has a pose that may be used without a second look."""
        return self.status == "placed"

    @property
    def uncertain(self) -> bool:
        """Whether it has a pose whose standard deviation is above the limit."""
        return self.status == "uncertain"

    @property
    def prior_deviation(self) -> tuple[float, float] | None:
        """Distance in metres, angle in radians from the pose of the prior; None where one of the two is not known."""
        if self.T_target_source is None or self.T_target_source_prior is None:
            return None
        return self.T_target_source_prior.distance_to(self.T_target_source)

    @property
    def sigma_xyz_m(self) -> FloatArray | None:
        """(3,) standard deviation of the position along the target's axes; None where it is not known."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance)[3:])

    @property
    def sigma_rotation_deg(self) -> FloatArray | None:
        """(3,) standard deviation of the rotation about the target's axes; None where it is not known."""
        return None if self.covariance is None else np.rad2deg(np.sqrt(np.diag(self.covariance)[:3]))
