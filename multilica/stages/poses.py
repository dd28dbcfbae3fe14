# SPDX-License-Identifier: Apache-2.0
"""When two poses are the same answer, which can be one vehicle's, and what lies beside one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from multilica.config import VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import Assessment

__all__ = ["is_distinct", "slid", "within_reach"]

_SAME_POSE_M = 0.3
_SAME_POSE_RAD = float(np.deg2rad(3.0))


def is_distinct(
    pose: RigidTransform,
    others: Iterable[RigidTransform],
    same_m: float = _SAME_POSE_M,
    same_rad: float = _SAME_POSE_RAD,
) -> bool:
    """Whether none of the other poses is the same answer: as near in translation, and in rotation."""
    distances = (pose.distance_to(other) for other in others)
    return all(metres > same_m or radians > same_rad for metres, radians in distances)


def within_reach(assessments: Sequence[Assessment], reach_m: float) -> list[Assessment]:
    """Those that leave both LiDARs on one vehicle, all if none does: GICP may carry a chance fit far away."""
    near = [each for each in assessments if float(np.linalg.norm(each.T_target_source.xyz_m)) <= reach_m]
    return near or list(assessments)


def slid(best: Assessment, config: VerifyConfig) -> list[RigidTransform]:
    """The pose shifted along its weakest direction: where facades or pillars repeat, the true one may be steps away."""
    pose, step_m = best.T_target_source, config.slide_step_m * best.testimony.slide_direction
    positions_m = [pose.xyz_m + side * step * step_m for step in range(1, config.slides + 1) for side in (-1.0, 1.0)]
    return [
        RigidTransform.from_rotation_translation(pose.target, pose.source, pose.rotation, xyz_m)
        for xyz_m in positions_m
        if np.linalg.norm(xyz_m) <= config.rival_reach_m
    ]
