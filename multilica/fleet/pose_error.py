# SPDX-License-Identifier: Apache-2.0
"""How far a pose is from the true one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from multilica.geometry import FloatArray, RigidTransform, read_only, rotation_angle_rad

__all__ = ["PoseError"]


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
