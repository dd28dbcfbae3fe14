# SPDX-License-Identifier: Apache-2.0
"""Pose from matches with some outliers: GNC-TLS rotation, TLS translation."""

from collections.abc import Sequence

import numpy as np

from multilica.geometry import FloatArray
from multilica.results import IndexArray

__all__ = ["align_points", "gnc_tls_rotations", "robust_poses", "tls_translation"]

# The defaults of TEASER++.
_GNC_FACTOR = 1.4
_GNC_MAX_ITERATIONS = 100
_GNC_COST_TOLERANCE = 1e-6
# Bound on time; strides from neighbours to half the set constrain the rotation.
_MAX_PAIRS_PER_POINT = 12


def align_points(target_m: FloatArray, source_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Fit rotation (3, 3) and translation (3,) with ``target ~ R @ source + t`` to (N, 3) points, N >= 3 (Kabsch)."""
    target_mean, source_mean = target_m.mean(axis=0), source_m.mean(axis=0)
    centred = (target_m - target_mean)[None], (source_m - source_mean)[None]
    rotation = _weighted_rotations(*centred, np.ones((1, len(target_m))))[0]
    return rotation, target_mean - rotation @ source_mean


def robust_poses(
    matches_m: Sequence[tuple[FloatArray, FloatArray]], noise_bound_m: float
) -> list[tuple[FloatArray, FloatArray]]:
    """Estimate the pose of each set of matches with a minority of outliers (TEASER++, T-RO 2020, VI and VII).

    Differences of matched points do not depend on the translation, so the rotations are found on them first.

    Args:
        matches_m: per set target and source points, (N, 3) each, N >= 3.
        noise_bound_m: largest error of a correct match.

    Returns:
        Rotation (3, 3) and translation (3,) of each set.
    """
    rotations = gnc_tls_rotations([_differences(*each) for each in matches_m], 2.0 * noise_bound_m)
    return [
        (rotation, tls_translation(target_m - source_m @ rotation.T, noise_bound_m))
        for rotation, (target_m, source_m) in zip(rotations, matches_m, strict=True)
    ]


def _differences(target_m: FloatArray, source_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    first, second = _spread_pairs(len(target_m))
    return target_m[first] - target_m[second], source_m[first] - source_m[second]


def _spread_pairs(count: int) -> tuple[IndexArray, IndexArray]:
    """Choose index pairs i < j: all of a small set, else a ring of strides, far and near, for each point."""
    if count <= 2 * _MAX_PAIRS_PER_POINT:
        first, second = np.triu_indices(count, k=1)
        return first.astype(np.int64), second.astype(np.int64)
    strides = np.unique(np.geomspace(1, count // 2, _MAX_PAIRS_PER_POINT).astype(np.int64))
    first = np.repeat(np.arange(count), len(strides))
    return first, (first + np.tile(strides, count)) % count


def gnc_tls_rotations(vectors_m: Sequence[tuple[FloatArray, FloatArray]], noise_bound_m: float) -> FloatArray:
    """Estimate the rotation of each set of vectors with outliers, by graduated non-convexity on a truncated cost.

    Yang et al., "Graduated Non-Convexity for Robust Spatial Perception", RA-L 2020, section IV-B. All sets take each
    step together until the last is done.

    Args:
        vectors_m: per set target and source vectors, (N, 3) each, with ``target ~ R @ source``.
        noise_bound_m: residuals beyond it are outliers.

    Returns:
        (S, 3, 3) rotations.
    """
    target, source, counted = _padded(vectors_m)
    bound_squared = noise_bound_m**2
    rotations = _weighted_rotations(target, source, counted)
    squared = _squared_residuals(target, source, rotations)
    worst = squared.max(axis=1, initial=0.0)
    mu = 1.0 / np.maximum(2.0 * worst / bound_squared - 1.0, 1e-12)
    previous_cost = np.full(len(rotations), np.inf)
    going = np.flatnonzero(worst > bound_squared)
    for _ in range(_GNC_MAX_ITERATIONS):
        step = mu[going, None]
        upper, lower = (step + 1.0) / step * bound_squared, step / (step + 1.0) * bound_squared
        middle = np.sqrt(bound_squared * step * (step + 1.0) / np.maximum(squared[going], 1e-12)) - step
        weights = np.where(squared[going] >= upper, 0.0, np.where(squared[going] <= lower, 1.0, middle))
        weights *= counted[going]
        enough = np.count_nonzero(weights, axis=1) >= 2
        going, weights = going[enough], weights[enough]
        if len(going) == 0:
            break
        rotations[going] = _weighted_rotations(target[going], source[going], weights)
        squared[going] = _squared_residuals(target[going], source[going], rotations[going])
        cost = np.sum(weights * squared[going], axis=1)
        changed = np.abs(cost - previous_cost[going]) >= _GNC_COST_TOLERANCE
        previous_cost[going] = cost
        mu[going] *= _GNC_FACTOR
        going = going[changed]
    return rotations


def _padded(vectors_m: Sequence[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Pad the sets to two (S, N, 3) arrays; return them with a mask (S, N), 0 for padding."""
    most = max((len(target_m) for target_m, _ in vectors_m), default=0)
    target, source = np.zeros((2, len(vectors_m), most, 3))
    counted = np.zeros((len(vectors_m), most))
    for index, (target_m, source_m) in enumerate(vectors_m):
        target[index, : len(target_m)], source[index, : len(source_m)] = target_m, source_m
        counted[index, : len(target_m)] = 1.0
    return target, source, counted


def tls_translation(offsets_m: FloatArray, noise_bound_m: float) -> FloatArray:
    """Find the translation (3,) that most offsets (N, 3) agree on, per axis (TEASER++, adaptive voting)."""
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


def _squared_residuals(target_m: FloatArray, source_m: FloatArray, rotations: FloatArray) -> FloatArray:
    return np.asarray(np.sum((target_m - source_m @ rotations.swapaxes(1, 2)) ** 2, axis=2))


def _weighted_rotations(target_m: FloatArray, source_m: FloatArray, weights: FloatArray) -> FloatArray:
    u, _, vt = np.linalg.svd((target_m * weights[..., None]).swapaxes(1, 2) @ source_m)
    u[..., -1] *= np.linalg.det(u @ vt)[..., None]
    return np.asarray(u @ vt)
