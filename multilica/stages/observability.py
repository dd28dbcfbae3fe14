# SPDX-License-Identifier: Apache-2.0
"""How firmly a registration holds its pose."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.config import FineConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import Hold, PairRegistration
from multilica.stages.gicp import register
from multilica.stages.registration_cloud import RegistrationCloud

__all__ = [
    "ROTATION_SCALE_M",
    "arc_between_m",
    "examine_hold",
    "pushed_ends",
    "weakest_curvature",
    "weakest_sigmas",
]

ROTATION_SCALE_M = 10.0
"""Lever arm that makes a rotation comparable with a translation."""


def weakest_curvature(registration: PairRegistration) -> float:
    """Smallest eigenvalue of the Hessian per inlier, in units where `ROTATION_SCALE_M` makes a rotation a length."""
    inliers = registration.steps[-1].inliers if registration.steps else 0
    if registration.hessian is None or inliers == 0:
        return 0.0
    scale = np.repeat([1.0 / ROTATION_SCALE_M, 1.0], 3)
    return float(np.linalg.eigvalsh(registration.hessian * np.outer(scale, scale) / inliers)[0])


def pushed_ends(
    clouds: tuple[RegistrationCloud, RegistrationCloud],
    pose: RigidTransform,
    weakest_direction: FloatArray,
    push_m: float,
    fine: FineConfig,
    threads: int,
) -> tuple[RigidTransform, RigidTransform]:
    """Where registration of target and source ends if the pose is pushed where it gives way most easily, either way.

    Args:
        weakest_direction: (6,) unit vector as `Testimony.weakest_direction`.
    """
    back, forth = (
        register(*clouds, _pushed(pose, side * push_m * weakest_direction), fine, threads).T_target_source
        for side in (-1.0, 1.0)
    )
    return back, forth


def examine_hold(
    thinned: tuple[RegistrationCloud, RegistrationCloud] | None,
    pose: RigidTransform,
    information: FloatArray | None,
    ends: tuple[RigidTransform, RigidTransform],
    push_m: float,
    fine: FineConfig,
    threads: int,
) -> Hold:
    """How far a registered pose gives way when it is pushed, and when points are taken away.

    Along a tunnel a registration stays where it is put, and a chance fit of ground and shrubs depends on which points
    there are. A pose that the scene holds comes back to a fraction of a millimetre.

    Args:
        thinned: target and source with fewer points; None where they have few.
        pose: where GICP ended.
        information: as `pose_information`.
        ends: as `pushed_ends` of that pose.
    """
    sigma_m, sigma_rad = weakest_sigmas(information)
    of_fewer = pose if thinned is None else register(*thinned, pose, fine, threads).T_target_source
    return Hold(
        sigma_m,
        sigma_rad,
        push_m,
        pushed_off_m=max(arc_between_m(pose, end) for end in ends),
        thinned_off_m=arc_between_m(pose, of_fewer),
    )


def arc_between_m(pose: RigidTransform, other: RigidTransform) -> float:
    """How far apart two poses are, a turn counted as the arc at `ROTATION_SCALE_M`."""
    metres, radians = pose.distance_to(other)
    return metres + ROTATION_SCALE_M * radians


def _pushed(pose: RigidTransform, motion: FloatArray) -> RigidTransform:
    turn = Rotation.from_rotvec(motion[:3] / ROTATION_SCALE_M).as_matrix()
    return RigidTransform.from_rotation_translation(
        pose.target, pose.source, turn @ pose.rotation, pose.xyz_m + motion[3:]
    )


def weakest_sigmas(information: FloatArray | None) -> tuple[float | None, float | None]:
    """Standard deviations in metres and rad, each in its weakest direction; `information` as `pose_information`."""
    if information is None:
        return None, None
    covariance = np.linalg.pinv(information, hermitian=True)
    variances = np.linalg.eigvalsh(covariance[3:, 3:])[-1], np.linalg.eigvalsh(covariance[:3, :3])[-1]
    sigma_m, sigma_rad = (float(np.sqrt(max(variance, 0.0))) for variance in variances)
    return sigma_m, sigma_rad
