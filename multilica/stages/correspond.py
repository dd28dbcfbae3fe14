# SPDX-License-Identifier: Apache-2.0
"""Matches of two LiDARs' points by their descriptors."""

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from multilica.config import CoarseConfig, CorrespondConfig
from multilica.geometry import FloatArray
from multilica.registration.poses import is_near
from multilica.results import Correspondences, FeatureCloud, IndexArray
from multilica.solvers.cliques import solve_by_cliques

# From 1500 x 1500 to 8000 x 1500, the order of the pairs of 70 simulated snapshots was equally good within the noise.
_PRIORITY_TARGETS, _PRIORITY_SOURCES = 1500, 1500

# Rows of distances that are computed at once: as many as the processor's cache holds.
_BLOCK = 64


def match_features(target: FeatureCloud, source: FeatureCloud, config: CorrespondConfig) -> Correspondences:
    """Match each descriptor of the source with the nearest of the target, the closest matches first.

    With `mutual`, a match is kept only if each is the other's nearest neighbour in descriptor space. Engine
    `brute_force` finds neighbours in single precision, so that any of several nearly identical descriptors may count
    as the nearest. Without a limit the matches keep the order of the source's points.
    """
    return _match(target, source, config, config.max_keypoints, config.max_keypoints)


def pair_priority(target: FeatureCloud, source: FeatureCloud, config: CoarseConfig, max_baseline_m: float) -> float:
    """Estimate from few descriptors how likely two LiDARs overlap enough to be registered.

    Returns:
        The largest number of sampled matches that agree on one pose; 0 if none do. Only the order between pairs of one
        rig has a meaning.
    """
    found = _match(target, source, CorrespondConfig(), _PRIORITY_TARGETS, _PRIORITY_SOURCES)
    matches = found.within_baseline(max_baseline_m)
    if len(matches) == 0:
        return 0.0
    solution = solve_by_cliques(matches, config.model_copy(update={"max_hypotheses": 1}))
    near = [pose for pose in solution.poses if is_near(pose, max_baseline_m)]
    agreeing = (matches.agreeing(pose, config.noise_bound_m, config.normal_tolerance_deg) for pose in near)
    return float(max(map(np.count_nonzero, agreeing), default=0))


def _match(
    target: FeatureCloud, source: FeatureCloud, config: CorrespondConfig, most_targets: int, most_sources: int
) -> Correspondences:
    nearest_pairs = _nearest_by_kd_tree if config.engine == "kd_tree" else _nearest_pairs
    of_target, of_source = _drawn(target, most_targets), _drawn(source, most_sources)
    pairs = np.empty((0, 2), dtype=np.int64)
    if len(of_target) and len(of_source):
        pairs = nearest_pairs(target.descriptors[of_target], source.descriptors[of_source], mutual=config.mutual)
    source_index, target_index = of_source[pairs[:, 0]], of_target[pairs[:, 1]]
    distances = np.linalg.norm(source.descriptors[source_index] - target.descriptors[target_index], axis=1)
    if config.max_matches:
        best = np.lexsort((source_index, distances))[: config.max_matches]
        source_index, target_index, distances = source_index[best], target_index[best], distances[best]
    return Correspondences(
        target=target.lidar,
        source=source.lidar,
        target_points_m=target.points_m[target_index],
        source_points_m=source.points_m[source_index],
        target_normals=target.normals[target_index],
        source_normals=source.normals[source_index],
        feature_distances=distances,
        target_index=target_index,
        source_index=source_index,
    )


def _drawn(cloud: FeatureCloud, most: int) -> IndexArray:
    """Draw the rows of at most this many descriptors; all if 0."""
    count = len(cloud.points_m)
    if most == 0 or count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).permutation(count)[:most])


def _nearest_pairs(target: FloatArray, source: FloatArray, *, mutual: bool) -> IndexArray:
    """Return (M, 2) rows of (N, K) source and target descriptors that are nearest to each other.

    Each squared distance is one entry of a matrix product: |s - t|^2 = (-2 s, 1, |s|^2) . (t, |t|^2, 1).
    """
    centre = target.mean(axis=0)
    target, source = target - centre, source - centre
    right = np.column_stack([target, _squared(target), np.ones(len(target))]).T.astype(np.float32, order="C")
    left = np.column_stack([-2.0 * source, np.ones(len(source)), _squared(source)]).astype(np.float32)
    nearest = np.empty(len(source), dtype=np.int64)
    least = np.empty(len(source), dtype=np.float32)
    least_of_target = np.full(len(target), np.inf, dtype=np.float32)
    for start in range(0, len(source), _BLOCK):
        rows = slice(start, start + _BLOCK)
        squared = left[rows] @ right
        nearest[rows] = squared.argmin(axis=1)
        least[rows] = squared[np.arange(len(squared)), nearest[rows]]
        np.minimum(least_of_target, squared.min(axis=0), out=least_of_target)
    if not mutual:
        return np.column_stack([np.arange(len(source)), nearest])
    chosen = np.flatnonzero(least == least_of_target[nearest])
    _, first = np.unique(nearest[chosen], return_index=True)
    chosen = np.sort(chosen[first])
    return np.column_stack([chosen, nearest[chosen]])


def _nearest_by_kd_tree(target: FloatArray, source: FloatArray, *, mutual: bool) -> IndexArray:
    """Do the same in double precision."""
    _, nearest = cKDTree(target).query(source)
    pairs = np.column_stack([np.arange(len(source)), nearest])
    if not mutual:
        return pairs
    _, nearest_source = cKDTree(source).query(target)
    return np.asarray(pairs[nearest_source[nearest] == pairs[:, 0]])


def _squared(descriptors: FloatArray) -> npt.NDArray[np.float64]:
    return np.asarray(np.einsum("ij,ij->i", descriptors, descriptors))
