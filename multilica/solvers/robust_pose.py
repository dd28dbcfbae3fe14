# SPDX-License-Identifier: Apache-2.0
"""Pose from matches with a minority of outliers."""

import numpy as np

from multilica.geometry import FloatArray

# A larger factor takes fewer steps; twice is a compromise of Yang et al.'s 1.4 with time.
_GNC_FACTOR = 2.0
# Beyond it nearly every weight is 0 or 1.
_GNC_SHARPEST = 10.0


def align_points(
    target_m: FloatArray, source_m: FloatArray, weights: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Fit rotation (3, 3) and translation (3,) with ``target ~ R @ source + t`` to (N, 3) points, N >= 3 (Kabsch).

    Args:
        weights: (N,) not negative; all equal if None.
    """
    share = np.full(len(target_m), 1.0 / len(target_m)) if weights is None else weights / weights.sum()
    target_mean, source_mean = share @ target_m, share @ source_m
    u, _, vt = np.linalg.svd((target_m - target_mean).T @ ((source_m - source_mean) * share[:, None]))
    u[:, -1] *= np.linalg.det(u @ vt)
    rotation = np.asarray(u @ vt)
    return rotation, target_mean - rotation @ source_mean


def robust_pose(target_m: FloatArray, source_m: FloatArray, noise_bound_m: float) -> tuple[FloatArray, FloatArray]:
    """Estimate the pose of matches with a minority of outliers, by graduated non-convexity on a truncated cost.

    Yang et al., "Graduated Non-Convexity for Robust Spatial Perception", RA-L 2020, section IV-B.

    Args:
        target_m, source_m: (N, 3) matched points, N >= 3.
        noise_bound_m: matches with larger residuals are outliers.

    Returns:
        Rotation (3, 3) and translation (3,).
    """
    bound_m2 = noise_bound_m**2
    rotation, translation = align_points(target_m, source_m)
    squared_m2 = _squared_residuals(target_m, source_m, rotation, translation)
    worst_m2 = squared_m2.max()
    mu = bound_m2 / (2.0 * worst_m2 - bound_m2) if worst_m2 > bound_m2 else np.inf
    while mu < _GNC_SHARPEST:
        weights = np.clip(np.sqrt(bound_m2 * mu * (mu + 1.0) / np.maximum(squared_m2, 1e-12)) - mu, 0.0, 1.0)
        if np.count_nonzero(weights) < 3:
            break
        rotation, translation = align_points(target_m, source_m, weights)
        squared_m2 = _squared_residuals(target_m, source_m, rotation, translation)
        mu *= _GNC_FACTOR
    return rotation, translation


def _squared_residuals(
    target_m: FloatArray, source_m: FloatArray, rotation: FloatArray, translation: FloatArray
) -> FloatArray:
    return np.asarray(np.sum((target_m - source_m @ rotation.T - translation) ** 2, axis=1))
