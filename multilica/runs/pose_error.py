# SPDX-License-Identifier: Apache-2.0
"""Errors of a pose against the true one."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, Self

import numpy as np
from scipy.special import ndtri_exp

from multilica.geometry import FloatArray, RigidTransform, read_only, rotation_angle_rad


@dataclass(frozen=True, slots=True, eq=False)
class PoseError:
    """The error of a pose, or a statistic of many errors.

    Args:
        translation_m: (3,) found - true position, along the axes of the run's target.
        rotation_rad: (3,) roll, pitch, yaw (extrinsic xyz) about those axes, from the true to the found orientation.
        distance_m: between the two positions.
        angle_rad: of the rotation from one orientation to the other.
    """

    translation_m: FloatArray
    rotation_rad: FloatArray
    distance_m: float
    angle_rad: float

    @property
    def angle_deg(self) -> float:
        """Angle in degrees."""
        return math.degrees(self.angle_rad)

    @property
    def figures(self) -> dict[str, float]:
        """All components, by the names that documents give them."""
        angles_deg = zip(("roll_deg", "pitch_deg", "yaw_deg"), np.rad2deg(self.rotation_rad).tolist(), strict=True)
        lengths_m = zip(("x_m", "y_m", "z_m"), self.translation_m.tolist(), strict=True)
        return {**dict(lengths_m), "distance_m": self.distance_m, **dict(angles_deg), "angle_deg": self.angle_deg}

    @classmethod
    def between(
        cls, found: RigidTransform, true: RigidTransform, *, about: Literal["target", "source"] = "target"
    ) -> Self:
        """Compute the error of a found `T_target_source`.

        Args:
            about: whose axes the rotation is about; the translation is along those of the target.
        """
        shift_m = found.xyz_m - true.xyz_m
        turn = found.rotation @ true.rotation.T if about == "target" else true.rotation.T @ found.rotation
        rpy_rad = RigidTransform.from_rotation_translation("", "", turn, shift_m).rpy_rad
        return cls(
            read_only(shift_m, np.float64),
            read_only(rpy_rad, np.float64),
            float(np.linalg.norm(shift_m)),
            rotation_angle_rad(turn),
        )

    @classmethod
    def statistic(cls, errors: Sequence[Self], of: Callable[[FloatArray], FloatArray]) -> Self | None:
        """Compute one figure per component; `of` maps (N, 8) absolute values to (8,). None without errors."""
        if not errors:
            return None
        rows = [[*error.translation_m, *error.rotation_rad, error.distance_m, error.angle_rad] for error in errors]
        figures = read_only(of(np.abs(np.array(rows))), np.float64)
        return cls(figures[:3], figures[3:6], float(figures[6]), float(figures[7]))


def normalised_error(found: RigidTransform, true: RigidTransform, covariance: FloatArray) -> float:
    """Compute the error of a found `T_target_source` in units of its own sigma.

    It is the Mahalanobis distance over six directions, divided by the root of six. With correct covariances its mean
    square is 1, its median 0.94.

    Args:
        covariance: (6, 6) positive definite, order rotation (rad), translation (m), both along the target's axes.
    """
    error = found.offset_from(true)
    return float(np.sqrt(error @ np.linalg.solve(covariance, error) / 6.0))


def as_sigma(normalised: float) -> float:
    """Return the deviation of one normal variable that is as rare as a `normalised_error`.

    Six times its square has a chi-square distribution of 6 degrees of freedom if the covariance is correct. As for one
    variable, 0.27 % of the errors exceed 3.
    """
    half = 3.0 * normalised**2
    # In logarithms: a pose that is metres off is too rare for a float.
    log_rarity = np.log1p(half + 0.5 * half**2) - half
    return max(0.0, -float(ndtri_exp(log_rarity - np.log(2.0))))
