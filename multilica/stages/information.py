# SPDX-License-Identifier: Apache-2.0
"""How firmly the points of two registered clouds hold their pose."""

from __future__ import annotations

import numpy as np

from multilica.config import RefineConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.stages.registration_cloud import RegistrationCloud

__all__ = ["pose_information"]

_MIN_MATCHES = 20


def pose_information(
    target: RegistrationCloud,
    source: RegistrationCloud,
    T_target_source: RigidTransform,
    config: RefineConfig,
    threads: int,
) -> FloatArray | None:
    """Information (inverse covariance) of the pose, from point-to-plane residuals at the optimum.

    Each source point with a target point within `distance_m` holds the pose along that point's normal n, by
    J = [a x n, n] with its arm a from the source's origin. GICP gives all of them the same weight, whatever they lie
    on, so its covariance is the sandwich H^-1 B H^-1 with H = sum J^T J and B = sum r^2 J^T J (White, Econometrica
    1980): a direction that only bushes and kerbs hold is known as badly as these fit. Neighbouring residuals are not
    independent (one surface, one beam pattern, one error of its normals), so only each `correlated_points`-th counts.

    Returns:
        (6, 6), order rotation (rad), translation (m), both along the target's axes, the rotation about the source's
        origin; None where too few points match or the engine gives no normals.
    """
    if target.normals is None:
        return None
    arms = T_target_source.rotate(source.points_m)
    moved = arms + T_target_source.xyz_m
    distance_m, index = target.tree.query(moved, distance_upper_bound=config.distance_m, workers=threads)
    matched = np.isfinite(distance_m)
    if np.count_nonzero(matched) < _MIN_MATCHES:
        return None
    normals = target.normals[index[matched]]
    residual_m = np.einsum("ij,ij->i", normals, moved[matched] - target.points_m[index[matched]])
    variance = np.maximum(residual_m**2, config.min_sigma_m**2)
    jacobian = np.concatenate([np.cross(arms[matched], normals), normals], axis=1)
    held = jacobian.T @ jacobian
    spread = jacobian.T @ (jacobian * variance[:, None])
    return np.asarray(held @ np.linalg.pinv(spread, hermitian=True) @ held / config.correlated_points)
