# SPDX-License-Identifier: Apache-2.0
"""Stability of a registered pose: curvature, pushes and standard deviations."""

import numpy as np

from multilica.config import FineConfig
from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform
from multilica.registration.gicp import register
from multilica.registration.gicp_cloud import GicpCloud
from multilica.registration.poses import moved
from multilica.results import PairRegistration, Stability
from multilica.results.registrations import weakest_sigmas


def weakest_curvature(registration: PairRegistration) -> float:
    """Return the smallest eigenvalue of the GICP Hessian per inlier, rotations scaled by `LEVER_ARM_M`."""
    inliers = registration.steps[-1].inliers if registration.steps else 0
    if registration.hessian is None or inliers == 0:
        return 0.0
    scale = np.repeat([1.0 / LEVER_ARM_M, 1.0], 3)
    return float(np.linalg.eigvalsh(registration.hessian * np.outer(scale, scale) / inliers)[0])


def perturbed_ends(
    clouds: tuple[GicpCloud, GicpCloud],
    pose: RigidTransform,
    weakest_direction: FloatArray,
    perturbation_m: float,
    fine: FineConfig,
) -> tuple[RigidTransform, RigidTransform]:
    """Register target and source from both sides of the pose, perturbed along `VisibilityScore.weakest_direction`."""
    pushes = (side * perturbation_m * weakest_direction for side in (-1.0, 1.0))
    starts = (moved(pose, push[:3] / LEVER_ARM_M, push[3:]) for push in pushes)
    back, forth = (register(*clouds, start, fine).T_target_source for start in starts)
    return back, forth


def check_stability(
    thinned: tuple[GicpCloud, GicpCloud] | None,
    pose: RigidTransform,
    information: FloatArray | None,
    ends: tuple[RigidTransform, RigidTransform],
    perturbation_m: float,
    fine: FineConfig,
) -> Stability:
    """Measure the motion of a registered pose after a perturbation, and with fewer points.

    Along a tunnel a registration stays at the perturbed pose. A chance fit of ground and shrubs depends on single
    points. A well constrained pose returns to within a fraction of a millimetre.

    Args:
        thinned: target and source with fewer points; None where they have few anyway.
        pose: where GICP ended.
        ends: of `perturbed_ends` for that pose.
    """
    of_fewer = pose if thinned is None else register(*thinned, pose, fine).T_target_source
    return Stability(
        *weakest_sigmas(information),
        perturbation_m,
        perturbed_offset_m=max(arc_between_m(pose, end) for end in ends),
        thinned_offset_m=arc_between_m(pose, of_fewer),
    )


def widened(information: FloatArray | None, direction: FloatArray, off_m: float) -> FloatArray | None:
    """Return the information of a pose from its offset along a direction after a perturbation.

    Args:
        information: of `pose_information`, or None.
        direction: (6,) as `VisibilityScore.weakest_direction`.
    """
    if information is None:
        return None
    step = off_m * direction / np.repeat([LEVER_ARM_M, 1.0], 3)
    pulled = information @ step
    return np.asarray(information - np.outer(pulled, pulled) / (1.0 + step @ pulled))


def arc_between_m(pose: RigidTransform, other: RigidTransform) -> float:
    """Return the distance between two poses, a rotation counted as the arc at `LEVER_ARM_M`."""
    metres, radians = pose.distance_to(other)
    return metres + LEVER_ARM_M * radians
