# SPDX-License-Identifier: Apache-2.0
"""How far a pose is from the true one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import ndtri_exp

from multilica.geometry import FloatArray, RigidTransform, read_only, rotation_angle_rad

__all__ = ["PoseError", "as_sigma", "normalised_error"]


@dataclass(frozen=True, slots=True, eq=False)
class PoseError:
    """How far a pose is from the true one, or a statistic of that over many.

    Args:
        translation_m: (3,) found less true position, along the axes of the run's target.
        rotation_rad: (3,) roll, pitch, yaw (extrinsic xyz) about those axes of the rotation from the true to the found
            orientation.
        distance_m: between the two positions.
        angle_rad: of the rotation from one orientation to the other.
    """

    translation_m: FloatArray
    rotation_rad: FloatArray
    distance_m: float
    angle_rad: float

    @property
    def angle_deg(self) -> float:
        """`angle_rad` for people."""
        return math.degrees(self.angle_rad)

    @classmethod
    def between(cls, found: RigidTransform, true: RigidTransform) -> Self:
        """The error of a found `T_target_source`."""
        turn, shift_m = found.rotation @ true.rotation.T, found.xyz_m - true.xyz_m
        rpy_rad = RigidTransform.from_rotation_translation(found.target, found.target, turn, shift_m).rpy_rad
        return cls(
            read_only(shift_m, np.float64),
            read_only(rpy_rad, np.float64),
            float(np.linalg.norm(shift_m)),
            rotation_angle_rad(turn),
        )

    @classmethod
    def statistic(cls, errors: Sequence[Self], of: Callable[[FloatArray], FloatArray]) -> Self | None:
        """One figure per component: `of` takes (N, 8) absolute values to (8,); None without errors."""
        if not errors:
            return None
        rows = [[*error.translation_m, *error.rotation_rad, error.distance_m, error.angle_rad] for error in errors]
        figures = read_only(of(np.abs(np.array(rows))), np.float64)
        return cls(figures[:3], figures[3:6], float(figures[6]), float(figures[7]))


def normalised_error(found: RigidTransform, true: RigidTransform, covariance: FloatArray) -> float:
    """How far off a found `T_target_source` is in units of its own sigma.

    The Mahalanobis distance over all six directions at once, divided by the root of six: of right covariances its
    square is 1 on average, its median 0.94.

    Args:
        covariance: (6, 6) positive definite, order rotation (rad), translation (m), both along the target's axes.
    """
    turn_rad = Rotation.from_matrix(found.rotation @ true.rotation.T).as_rotvec()
    error = np.concatenate([turn_rad, found.xyz_m - true.xyz_m])
    return float(np.sqrt(error @ np.linalg.solve(covariance, error) / 6.0))


def as_sigma(normalised: float) -> float:
    """The deviation of one normal variable that is as rare as that `normalised_error`.

    Six times its square has a chi-square distribution of 6 degrees of freedom if the covariance is right. So 3, as for
    one variable, is exceeded by 0.27 % of right covariances.
    """
    half = 3.0 * normalised**2
    # In logarithms: a pose that is metres off is too rare for a float.
    log_rarity = np.log1p(half + 0.5 * half**2) - half
    return max(0.0, -float(ndtri_exp(log_rarity - np.log(2.0))))
