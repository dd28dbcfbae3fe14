# SPDX-License-Identifier: Apache-2.0
"""LiDARs in the result document."""

import math

import numpy as np
from pydantic import Field

from multilica.geometry import FloatArray, largest_index
from multilica.results.clouds import SensorHealth
from multilica.results.placements import ContestedPlace, PlacementStatus, SigmaOrigin, Spread
from multilica.results.values import Entry, Matrix4, Matrix6, Number, PoseEntry, Quaternion, Vector3


class PriorEntry(PoseEntry):
    """The pose that the prior gives, in the target frame."""

    deviation_m: Number = Field(description="Distance of the result from the prior; null without a pose.")
    deviation_deg: Number = Field(description="Angle of the result from the prior; null without a pose.")
    surprise: str | None = Field(description="Warning about a result that is far from the prior; null if it is near.")


class LidarEntry(Entry):
    """One LiDAR of the rig."""

    placed: bool = Field(description="True if the LiDAR has a pose that can be used without further checks.")
    status: PlacementStatus = Field(
        description="`uncertain`: one pose fits, uncontradicted, but its standard deviation is above the limit."
    )
    T_target_source: Matrix4 | None = Field(
        description="Rows of the matrix: p_target = T_target_source @ p_source; null if not placed nor uncertain."
    )
    xyz_m: Vector3 | None = Field(description="Position in the target frame.")
    rpy_deg: Vector3 | None = Field(description="Roll, pitch, yaw, extrinsic xyz, about the fixed axes of the target.")
    quaternion_xyzw: Quaternion | None = Field(description="Rotation as a unit quaternion, w last.")
    fitness: Number = Field(description="Share of the points that lie near a surface of the target cloud.")
    rmse_m: Number = Field(description="RMS distance of those points to their nearest target point.")
    sigma_xyz_m: Vector3 | None = Field(description="Standard deviation along the axes of the target.")
    sigma_rotation_deg: Vector3 | None = Field(description="Standard deviation about the axes of the target.")
    sigma_from: SigmaOrigin = Field(description="Source of the covariance: residuals, or their widening to the spread.")
    covariance: Matrix6 | None = Field(description="Order: rotation (rad), translation (m), along the target's axes.")
    prior: PriorEntry | None = Field(description="The pose that the prior gives; null without a prior.")
    spread: Spread | None = Field(description="Scatter over snapshots; null for a single snapshot.")
    contested: ContestedPlace | None = Field(description="Accepted pairs that contradict each other on it, or null.")
    reason: str = Field(
        description="The pair or step that placed the LiDAR, or the reason why it is uncertain or not placed."
    )
    health: SensorHealth | None = Field(description="Findings about the sensor; null if it was not examined.")

    def weakest_directions(self) -> tuple[tuple[float, str], tuple[float, str]]:
        """Return the largest standard deviations of position (m) and rotation (deg), each with its main axis.

        Raises:
            ValueError: the LiDAR has no covariance.
        """
        if self.covariance is None:
            raise ValueError("there is no covariance")
        covariance = np.asarray(self.covariance)
        sigma_rad, about = _weakest_direction(covariance[:3, :3])
        return _weakest_direction(covariance[3:, 3:]), (math.degrees(sigma_rad), about)


def _weakest_direction(covariance: FloatArray) -> tuple[float, str]:
    variances, directions = np.linalg.eigh(covariance)
    return math.sqrt(max(float(variances[-1]), 0.0)), "xyz"[largest_index(directions[:, -1])]
