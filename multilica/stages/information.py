# SPDX-License-Identifier: Apache-2.0
"""How firmly the points of two registered clouds hold their pose."""

from __future__ import annotations

import numpy as np

from multilica.config import RefineConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.stages.observability import ROTATION_SCALE_M
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
    on, so its covariance is the sandwich H^-1 B H^-1 with B = sum r^2 J^T J (White, Econometrica 1980): a direction
    that only bushes and kerbs hold is known as badly as these fit. Between the rings of a sparse sensor normals are
    mostly noise, and a tilted normal of the ground would hold the pose sideways: H = sum J^T J' takes J' from the
    source's own normals, whose noise is another one and averages out (instrumental variables: Reiersol, 1945).
    Neighbouring residuals are not independent (one surface, one beam pattern, one error of its normals), so only each
    `correlated_points`-th counts.

    Returns:
        (6, 6), order rotation (rad), translation (m), both along the target's axes, the rotation about the source's
        origin; None where too few points match or the engine gives no normals.
    """
    if target.normals is None or source.normals is None:
        return None
    arms = T_target_source.rotate(source.points_m)
    moved = arms + T_target_source.xyz_m
    distance_m, index = target.tree.query(moved, distance_upper_bound=config.distance_m, workers=threads)
    matched = np.isfinite(distance_m)
    if np.count_nonzero(matched) < _MIN_MATCHES:
        return None
    arms, offsets = arms[matched], moved[matched] - target.points_m[index[matched]]
    normals, others = target.normals[index[matched]], T_target_source.rotate(source.normals[matched])
    others = np.where(np.einsum("ij,ij->i", normals, others)[:, None] < 0.0, -others, others)
    residual_m = np.einsum("ij,ij->i", normals, offsets)
    variance = np.maximum(residual_m**2, config.min_sigma_m**2)
    jacobian, other_jacobian = (np.concatenate([np.cross(arms, each), each], axis=1) for each in (normals, others))
    spread = jacobian.T @ (jacobian * variance[:, None])
    held, spread = _floored(jacobian.T @ other_jacobian, spread, config.distance_m)
    return np.asarray(held @ np.linalg.pinv(spread, hermitian=True) @ held / config.correlated_points)


def _floored(held: FloatArray, spread: FloatArray, distance_m: float) -> tuple[FloatArray, FloatArray]:
    """H, symmetric, and B: where noise alone is left of H, one point holds, off by the whole distance of a match.

    Turns count as arcs 10 m away.
    """
    scale = np.repeat([1.0 / ROTATION_SCALE_M, 1.0], 3)
    lengths = np.outer(scale, scale)
    values, directions = np.linalg.eigh(0.5 * (held + held.T) * lengths)
    loose = directions[:, values < 1.0]
    floored = (directions * np.maximum(values, 1.0)) @ directions.T
    return floored / lengths, spread + distance_m**2 * (loose @ loose.T) / lengths
