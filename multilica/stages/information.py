# SPDX-License-Identifier: Apache-2.0
"""How firmly the points of two registered clouds hold their pose."""

from __future__ import annotations

import numpy as np

from multilica.config import RefineConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.stages.registration_cloud import RegistrationCloud

__all__ = ["pose_information"]

_MIN_MATCHES = 20
_MAD_TO_SIGMA = 1.4826


def pose_information(
    target: RegistrationCloud,
    source: RegistrationCloud,
    T_target_source: RigidTransform,
    config: RefineConfig,
    threads: int,
) -> FloatArray | None:
    """Information (inverse covariance) of the pose, from point-to-plane residuals at the optimum.

    Each source point with a target point within `distance_m` holds the pose along that point's normal n, by
    J = [a x n, n] with its arm a from the source's origin; sigma is the residuals' own robust deviation. Neighbouring
    residuals are not independent (one surface, one beam pattern, one error of its normals), so only each
    `correlated_points`-th counts.

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
    sigma_m = max(_MAD_TO_SIGMA * float(np.median(np.abs(residual_m))), config.min_sigma_m)
    jacobian = np.concatenate([np.cross(arms[matched], normals), normals], axis=1)
    jacobian = jacobian[np.abs(residual_m) <= 3.0 * sigma_m]
    return np.asarray(jacobian.T @ jacobian / (sigma_m**2 * config.correlated_points))
