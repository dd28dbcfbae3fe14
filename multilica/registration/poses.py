# SPDX-License-Identifier: Apache-2.0
"""Comparison and selection of poses."""

from collections.abc import Iterable, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform
from multilica.results import Hypothesis, Registration

# Poses as near as this lie in one basin of GICP.
_SAME_POSE_M = 0.3
_SAME_POSE_RAD = float(np.deg2rad(3.0))
_SLIDE_STEPS = 6
SLIDE_STEP_M = 1.0
"""Step along the weakest direction."""


def is_distinct(
    pose: RigidTransform,
    others: Iterable[RigidTransform],
    same_m: float = _SAME_POSE_M,
    same_rad: float = _SAME_POSE_RAD,
) -> bool:
    """Return whether the pose differs from all others, in translation or in rotation."""
    distances = (pose.distance_to(other) for other in others)
    return all(metres > same_m or radians > same_rad for metres, radians in distances)


def arc_between_m(pose: RigidTransform, other: RigidTransform) -> float:
    """Return the distance between two poses, a rotation counted as the arc at `LEVER_ARM_M`."""
    metres, radians = pose.distance_to(other)
    return metres + LEVER_ARM_M * radians


def is_near(pose: RigidTransform, max_baseline_m: float) -> bool:
    """Return whether the origins of both frames are no farther apart than this."""
    return float(np.linalg.norm(pose.xyz_m)) <= max_baseline_m


def moved(pose: RigidTransform, turn_rad: FloatArray, shift_m: FloatArray) -> RigidTransform:
    """Turn a pose by a rotation vector (3,), and shift it by (3,), both along the target's axes."""
    rotation = Rotation.from_rotvec(turn_rad).as_matrix() @ pose.rotation
    return RigidTransform.from_rotation_translation(pose.target, pose.source, rotation, pose.xyz_m + shift_m)


def within_baseline(registrations: Sequence[Registration], max_baseline_m: float) -> list[Registration]:
    """Select the poses that leave both LiDARs on one vehicle; all of them if none does."""
    return [each for each in registrations if is_near(each.T_target_source, max_baseline_m)] or list(registrations)


def slid_hypotheses(
    start: Hypothesis, direction: FloatArray, max_baseline_m: float, steps: int = _SLIDE_STEPS
) -> list[Hypothesis]:
    """Shift a pose in steps to both sides: where facades or pillars repeat, the true one may be steps away.

    Args:
        direction: (3,) unit vector in the target's frame.
        steps: to either side.
    """
    found = []
    for signed in (side * step for step in range(1, steps + 1) for side in (-1.0, 1.0)):
        pose = moved(start.T_target_source, np.zeros(3), signed * (SLIDE_STEP_M * direction))
        if is_near(pose, max_baseline_m):
            words = f"slid by {signed * SLIDE_STEP_M:+g} m"
            found.append(Hypothesis(pose, origin=start.origin, index=start.index, derivation=words))
    return found
