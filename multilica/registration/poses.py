# SPDX-License-Identifier: Apache-2.0
"""Comparison and selection of poses."""

from collections.abc import Iterable, Sequence

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import Registration

__all__ = ["SAME_POSE_M", "SAME_POSE_RAD", "is_distinct", "slid", "within_baseline"]

SAME_POSE_M = 0.3
SAME_POSE_RAD = float(np.deg2rad(3.0))
"""Poses as near as this lie in one basin of GICP."""


def is_distinct(
    pose: RigidTransform,
    others: Iterable[RigidTransform],
    same_m: float = SAME_POSE_M,
    same_rad: float = SAME_POSE_RAD,
) -> bool:
    """Tell whether the pose differs from all others, in translation or in rotation."""
    distances = (pose.distance_to(other) for other in others)
    return all(metres > same_m or radians > same_rad for metres, radians in distances)


def within_baseline(registrations: Sequence[Registration], max_baseline_m: float) -> list[Registration]:
    """Select the poses that leave both LiDARs on one vehicle; all of them if none does."""
    near = [each for each in registrations if float(np.linalg.norm(each.T_target_source.xyz_m)) <= max_baseline_m]
    return near or list(registrations)


def slid(
    pose: RigidTransform, direction: FloatArray, step_m: float, steps: int, max_baseline_m: float
) -> list[RigidTransform]:
    """Shift a pose in steps to both sides: where facades or pillars repeat, the true one may be steps away.

    Args:
        direction: (3,) unit vector in the target's frame.
        steps: number of steps to either side.
    """
    positions_m = [
        pose.xyz_m + side * step * (step_m * direction) for step in range(1, steps + 1) for side in (-1.0, 1.0)
    ]
    return [
        RigidTransform.from_rotation_translation(pose.target, pose.source, pose.rotation, xyz_m)
        for xyz_m in positions_m
        if np.linalg.norm(xyz_m) <= max_baseline_m
    ]
