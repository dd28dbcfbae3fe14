# SPDX-License-Identifier: Apache-2.0
"""Stability of a registered pose: curvature, pushes and standard deviations."""

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.config import FineConfig
from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform
from multilica.registration.gicp import register
from multilica.registration.registration_cloud import RegistrationCloud
from multilica.results import PairRegistration, Stability

__all__ = [
    "arc_between_m",
    "check_stability",
    "pushed_ends",
    "weakest_curvature",
    "weakest_sigmas",
]


def weakest_curvature(registration: PairRegistration) -> float:
    """Return the smallest eigenvalue of the GICP Hessian per inlier, rotations scaled by `LEVER_ARM_M`."""
    inliers = registration.steps[-1].inliers if registration.steps else 0
    if registration.hessian is None or inliers == 0:
        return 0.0
    scale = np.repeat([1.0 / LEVER_ARM_M, 1.0], 3)
    return float(np.linalg.eigvalsh(registration.hessian * np.outer(scale, scale) / inliers)[0])


def pushed_ends(
    clouds: tuple[RegistrationCloud, RegistrationCloud],
    pose: RigidTransform,
    weakest_direction: FloatArray,
    push_m: float,
    fine: FineConfig,
    threads: int,
) -> tuple[RigidTransform, RigidTransform]:
    """Register target and source from both sides of the pose, pushed along its weakest direction.

    Args:
        weakest_direction: (6,) unit vector as `VisibilityScore.weakest_direction`.
    """
    back, forth = (
        register(*clouds, _pushed(pose, side * push_m * weakest_direction), fine, threads).T_target_source
        for side in (-1.0, 1.0)
    )
    return back, forth


def check_stability(
    thinned: tuple[RegistrationCloud, RegistrationCloud] | None,
    pose: RigidTransform,
    information: FloatArray | None,
    ends: tuple[RigidTransform, RigidTransform],
    push_m: float,
    fine: FineConfig,
    threads: int,
) -> Stability:
    """Measure how far a registered pose moves when it is pushed, and when points are removed.

    Along a tunnel a registration stays where it is pushed to. A chance fit of ground and shrubs depends on single
    points. A well constrained pose returns to within a fraction of a millimetre.

    Args:
        thinned: target and source with fewer points; None where they have few anyway.
        pose: where GICP ended.
        information: as `pose_information`.
        ends: of `pushed_ends` for that pose.
    """
    sigma_m, sigma_rad = weakest_sigmas(information)
    of_fewer = pose if thinned is None else register(*thinned, pose, fine, threads).T_target_source
    return Stability(
        sigma_m,
        sigma_rad,
        push_m,
        pushed_off_m=max(arc_between_m(pose, end) for end in ends),
        thinned_off_m=arc_between_m(pose, of_fewer),
    )


def arc_between_m(pose: RigidTransform, other: RigidTransform) -> float:
    """Return the distance between two poses, a rotation counted as the arc at `LEVER_ARM_M`."""
    metres, radians = pose.distance_to(other)
    return metres + LEVER_ARM_M * radians


def _pushed(pose: RigidTransform, motion: FloatArray) -> RigidTransform:
    turn = Rotation.from_rotvec(motion[:3] / LEVER_ARM_M).as_matrix()
    return RigidTransform.from_rotation_translation(
        pose.target, pose.source, turn @ pose.rotation, pose.xyz_m + motion[3:]
    )


def weakest_sigmas(information: FloatArray | None) -> tuple[float | None, float | None]:
    """Return the largest standard deviations, position (m) and rotation (rad); `information` as `pose_information`."""
    if information is None:
        return None, None
    covariance = np.linalg.pinv(information, hermitian=True)
    variances = np.linalg.eigvalsh(covariance[3:, 3:])[-1], np.linalg.eigvalsh(covariance[:3, :3])[-1]
    sigma_m, sigma_rad = (float(np.sqrt(max(variance, 0.0))) for variance in variances)
    return sigma_m, sigma_rad
