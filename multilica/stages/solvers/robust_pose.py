# SPDX-License-Identifier: Apache-2.0
"""The pose of matches of which some are still wrong: GNC-TLS rotation, TLS translation."""

from __future__ import annotations

import numpy as np

from multilica.geometry import FloatArray
from multilica.results import BoolArray, IndexArray

__all__ = ["align_points", "gnc_tls_rotation", "robust_pose", "tls_translation"]

_GNC_FACTOR = 1.4
_GNC_MAX_ITERATIONS = 100
_GNC_COST_TOLERANCE = 1e-6
_MAX_PAIRS_PER_POINT = 12


def align_points(target_m: FloatArray, source_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Least-squares rotation (3, 3) and translation (3,) with ``target ~ R @ source + t`` (Kabsch).

    Args:
        target_m, source_m: (N, 3), N >= 3.
    """
    target_mean, source_mean = target_m.mean(axis=0), source_m.mean(axis=0)
    rotation = _weighted_rotation(target_m - target_mean, source_m - source_mean, np.ones(len(target_m)))
    return rotation, target_mean - rotation @ source_mean


def robust_pose(
    target_m: FloatArray, source_m: FloatArray, noise_bound_m: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Pose of matches of which a minority is wrong, after TEASER++ (Yang et al., T-RO 2020, sections VI and VII).

    Differences of matched points do not depend on the translation, so the rotation is found on them first.

    Args:
        target_m, source_m: (N, 3), N >= 3.
        noise_bound_m: largest error of a correct match.

    Returns:
        Rotation (3, 3), translation (3,), and which matches lie within the noise bound, (N,).
    """
    first, second = _spread_pairs(len(target_m))
    rotation = gnc_tls_rotation(
        target_m[first] - target_m[second], source_m[first] - source_m[second], 2.0 * noise_bound_m
    )
    translation = tls_translation(target_m - source_m @ rotation.T, noise_bound_m)
    residual_m = np.linalg.norm(target_m - source_m @ rotation.T - translation, axis=1)
    return rotation, translation, residual_m <= noise_bound_m


def _spread_pairs(count: int) -> tuple[IndexArray, IndexArray]:
    """Index pairs i < j: all of a small set, else a ring of strides that reaches far and near for each point."""
    if count <= 2 * _MAX_PAIRS_PER_POINT:
        first, second = np.triu_indices(count, k=1)
        return first.astype(np.int64), second.astype(np.int64)
    strides = np.unique(np.geomspace(1, count // 2, _MAX_PAIRS_PER_POINT).astype(np.int64))
    first = np.repeat(np.arange(count), len(strides))
    return first, (first + np.tile(strides, count)) % count


def gnc_tls_rotation(target_m: FloatArray, source_m: FloatArray, noise_bound_m: float) -> FloatArray:
    """Rotation (3, 3) of vectors with outliers, by graduated non-convexity on a truncated least-squares cost.

    Yang et al., "Graduated Non-Convexity for Robust Spatial Perception", RA-L 2020, section IV-B.

    Args:
        target_m, source_m: (N, 3) vectors with ``target ~ R @ source``.
        noise_bound_m: residuals beyond it are outliers.
    """
    bound_squared = noise_bound_m**2
    weights = np.ones(len(target_m))
    rotation = _weighted_rotation(target_m, source_m, weights)
    squared = _squared_residuals(target_m, source_m, rotation)
    mu = 1.0 / max(2.0 * squared.max() / bound_squared - 1.0, 1e-12)
    if mu <= 0.0 or squared.max() <= bound_squared:
        return rotation
    previous_cost = np.inf
    for _ in range(_GNC_MAX_ITERATIONS):
        upper, lower = (mu + 1.0) / mu * bound_squared, mu / (mu + 1.0) * bound_squared
        middle = np.sqrt(bound_squared * mu * (mu + 1.0) / np.maximum(squared, 1e-12)) - mu
        weights = np.where(squared >= upper, 0.0, np.where(squared <= lower, 1.0, middle))
        if np.count_nonzero(weights) < 2:
            break
        rotation = _weighted_rotation(target_m, source_m, weights)
        squared = _squared_residuals(target_m, source_m, rotation)
        cost = float(weights @ squared)
        if abs(cost - previous_cost) < _GNC_COST_TOLERANCE:
            break
        previous_cost = cost
        mu *= _GNC_FACTOR
    return rotation


def tls_translation(offsets_m: FloatArray, noise_bound_m: float) -> FloatArray:
    """Translation (3,) that most offsets (N, 3) agree on, each axis by itself (TEASER++, adaptive voting)."""
    return np.array([_tls_scalar(axis, noise_bound_m) for axis in offsets_m.T])


def _tls_scalar(values: FloatArray, bound: float) -> float:
    """Minimise the truncated squared distance: slide a window of two bounds over the sorted values."""
    ordered = np.sort(values)
    last = np.searchsorted(ordered, ordered + 2.0 * bound, side="right")
    counts = last - np.arange(len(ordered))
    sums = np.concatenate([[0.0], np.cumsum(ordered)])
    squares = np.concatenate([[0.0], np.cumsum(ordered**2)])
    total = sums[last] - sums[: len(ordered)]
    means = total / counts
    spread = squares[last] - squares[: len(ordered)] - total * means
    cost = spread + (len(ordered) - counts) * bound**2
    return float(means[np.argmin(cost)])


def _squared_residuals(target_m: FloatArray, source_m: FloatArray, rotation: FloatArray) -> FloatArray:
    return np.asarray(np.sum((target_m - source_m @ rotation.T) ** 2, axis=1))


def _weighted_rotation(target_m: FloatArray, source_m: FloatArray, weights: FloatArray) -> FloatArray:
    u, _, vt = np.linalg.svd((target_m * weights[:, None]).T @ source_m)
    return np.asarray((u * [1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)
