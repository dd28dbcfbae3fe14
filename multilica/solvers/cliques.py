# SPDX-License-Identifier: Apache-2.0
"""The built-in solver: one pose per maximal clique of consistent matches."""

from collections.abc import Sequence

import numpy as np

from multilica.config import CoarseConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.poses import is_distinct
from multilica.results import BoolArray, Correspondences, IndexArray, Solution
from multilica.solvers.consistency_graph import build_consistency_graph, grow_clique

# Fewer points do not determine a pose.
_MIN_MATCHES = 3
# Several cliques lead to the same pose, so more are grown than hypotheses are asked for.
_CLIQUES_PER_HYPOTHESIS = 2
# A pose that stands out after so many cliques ends the search: it has this many agreeing matches, and this many times
# those of every other pose (docs/decisions/0002-cliques-of-lengths-and-angles.md).
_FIRST_CLIQUES = 8
_OUTSTANDING_MATCHES = 40
_OUTSTANDING_RATIO = 2.0
# A clique is consistent to within twice the noise bound; the last fits take the matches within the bound.
_CLIQUE_BOUNDS = 2.0
_REFIT_BOUNDS = (2.0, 1.0, 1.0)
# A larger factor takes fewer steps; twice is a compromise of Yang et al.'s 1.4 with time.
_GNC_FACTOR = 2.0
# Beyond it nearly every weight is 0 or 1.
_GNC_SHARPEST = 10.0


def solve_by_cliques(matches: Correspondences, config: CoarseConfig) -> Solution:
    """Solve by the idea of TEASER++ (Yang et al., T-RO 2020), extended to several hypotheses.

    Build a consistency graph on invariant lengths and angles. Grow a clique from the match that is consistent with the
    most matches that no pose explains yet; estimate its pose by graduated non-convexity; fit that to all matches that
    agree. These are explained. Go on until one pose stands out or enough cliques are grown.
    """
    graph = build_consistency_graph(matches, config.noise_bound_m, config.normal_tolerance_deg)
    neighbours = np.count_nonzero(graph, axis=1)
    edges = int(neighbours.sum()) // 2
    explained = np.zeros(len(matches), dtype=np.bool_)
    found: list[tuple[RigidTransform, int]] = []
    largest = 0
    while len(found) < _CLIQUES_PER_HYPOTHESIS * config.max_hypotheses:
        first = int(neighbours.argmax())
        if neighbours[first] < _MIN_MATCHES - 1 or (len(found) == _FIRST_CLIQUES and _stands_out(found)):
            break
        clique = grow_clique(graph, first)
        largest = max(largest, len(clique))
        explains = np.zeros_like(explained)
        if len(clique) >= _MIN_MATCHES:
            pose, explains = _fit(matches, clique, config)
            found.append((pose, int(np.count_nonzero(explains))))
        explains[clique] = True
        neighbours -= np.count_nonzero(graph[explains & ~explained], axis=0)
        explained |= explains
        neighbours[explained] = 0
    return Solution(tuple(pose for pose, _ in found), edges, largest)


def _fit(matches: Correspondences, clique: IndexArray, config: CoarseConfig) -> tuple[RigidTransform, BoolArray]:
    """Fit a pose to a clique and to what agrees with it; tell which matches do."""
    target_m, source_m = matches.target_points_m, matches.source_points_m
    rotation, translation = robust_pose(target_m[clique], source_m[clique], _CLIQUE_BOUNDS * config.noise_bound_m)
    for bounds in _REFIT_BOUNDS:
        residual_m = np.linalg.norm(target_m - source_m @ rotation.T - translation, axis=1)
        agree = residual_m <= bounds * config.noise_bound_m
        if np.count_nonzero(agree) < _MIN_MATCHES:
            break
        rotation, translation = align_points(target_m[agree], source_m[agree])
    pose = matches.pose(rotation, translation)
    return pose, matches.agreeing(pose, config.noise_bound_m, config.normal_tolerance_deg)


def _stands_out(found: Sequence[tuple[RigidTransform, int]]) -> bool:
    best, most = max(found, key=lambda each: each[1])
    others = [agreeing for pose, agreeing in found if is_distinct(pose, [best])]
    return most >= max(_OUTSTANDING_MATCHES, _OUTSTANDING_RATIO * max(others, default=0))


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
