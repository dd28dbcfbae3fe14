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

__all__ = ["ROTATION_SCALE_M", "examine_hold", "weakest_curvature", "weakest_sigmas"]

ROTATION_SCALE_M = 10.0
"""Lever arm that makes a rotation comparable with a translation."""


def weakest_curvature(registration: PairRegistration) -> float:
    """Smallest eigenvalue of the Hessian per inlier, in units where `ROTATION_SCALE_M` makes a rotation a length."""
    inliers = registration.steps[-1].inliers if registration.steps else 0
    if registration.hessian is None or inliers == 0:
        return 0.0
    scale = np.repeat([1.0 / ROTATION_SCALE_M, 1.0], 3)
    return float(np.linalg.eigvalsh(registration.hessian * np.outer(scale, scale) / inliers)[0])


def examine_hold(
    clouds: tuple[RegistrationCloud, RegistrationCloud],
    thinned: tuple[RegistrationCloud, RegistrationCloud],
    registration: PairRegistration,
    weakest_direction: FloatArray,
    push_m: float,
    fine: FineConfig,
    threads: int,
) -> Hold:
    """Push a registered pose where it gives way most easily, and take points away: what holds it brings it back.

    Along a tunnel a registration stays where it is put, and a chance fit of ground and shrubs depends on which points
    there are. A pose that the scene holds comes back to a fraction of a millimetre.

    Args:
        clouds: target and source as they were registered.
        thinned: the same with fewer points.
        weakest_direction: (6,) unit vector as `Testimony.weakest_direction`.
    """
    pose = registration.T_target_source
    starts = [_pushed(pose, side * push_m * weakest_direction) for side in (-1.0, 1.0)]
    ends = [register(*clouds, start, fine, threads).T_target_source for start in starts]
    sigma_m, sigma_rad = weakest_sigmas(registration.information)
    return Hold(
        sigma_m,
        sigma_rad,
        push_m,
        pushed_off_m=max(_off_m(pose, end) for end in ends),
        thinned_off_m=_off_m(pose, register(*thinned, pose, fine, threads).T_target_source),
    )


def _pushed(pose: RigidTransform, motion: FloatArray) -> RigidTransform:
    turn = Rotation.from_rotvec(motion[:3] / ROTATION_SCALE_M).as_matrix()
    return RigidTransform.from_rotation_translation(
        pose.target, pose.source, turn @ pose.rotation, pose.xyz_m + motion[3:]
    )


def _off_m(pose: RigidTransform, other: RigidTransform) -> float:
    metres, radians = pose.distance_to(other)
    return metres + ROTATION_SCALE_M * radians


def weakest_sigmas(information: FloatArray | None) -> tuple[float | None, float | None]:
    """Standard deviations in metres and rad, each in its weakest direction; `information` as `pose_information`."""
    if information is None:
        return None, None
    covariance = np.linalg.pinv(information, hermitian=True)
    variances = np.linalg.eigvalsh(covariance[3:, 3:])[-1], np.linalg.eigvalsh(covariance[:3, :3])[-1]
    sigma_m, sigma_rad = (float(np.sqrt(max(variance, 0.0))) for variance in variances)
    return sigma_m, sigma_rad
