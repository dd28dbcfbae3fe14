# SPDX-License-Identifier: Apache-2.0
"""Solvers of other libraries: Open3D, KISS-Matcher."""

from typing import Any

import numpy as np

from multilica.config import CoarseConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.optional_libraries import needed_for
from multilica.registration.lazy_open3d import open3d_for
from multilica.results import Correspondences
from multilica.solvers.solution import Solution

# As in the example of Open3D for FPFH matches, with ten times the iterations for more outliers.
_RANSAC_ITERATIONS = 1_000_000
_RANSAC_CONFIDENCE = 0.999
_EDGE_LENGTH_SIMILARITY = 0.9

o3d = open3d_for("The solver 'ransac' or 'fgr'")


def solve_by_ransac(matches: Correspondences, config: CoarseConfig, seed: int) -> Solution:
    """Solve by RANSAC on three matches at a time, with lengths checked first."""
    registration = o3d.pipelines.registration
    o3d.utility.random.seed(seed)
    target, source, pairs = _clouds(matches)
    result = registration.registration_ransac_based_on_correspondence(
        source,
        target,
        pairs,
        config.noise_bound_m,
        registration.TransformationEstimationPointToPoint(with_scaling=False),
        3,
        [
            registration.CorrespondenceCheckerBasedOnEdgeLength(_EDGE_LENGTH_SIMILARITY),
            registration.CorrespondenceCheckerBasedOnDistance(config.noise_bound_m),
        ],
        registration.RANSACConvergenceCriteria(_RANSAC_ITERATIONS, _RANSAC_CONFIDENCE),
    )
    rotation, translation = result.transformation[:3, :3], result.transformation[:3, 3]
    return _one_pose(matches, rotation, translation) if result.fitness > 0.0 else Solution()


def solve_by_fgr(matches: Correspondences, config: CoarseConfig, seed: int) -> Solution:
    """Solve by fast global registration (Zhou et al., ECCV 2016)."""
    registration = o3d.pipelines.registration
    o3d.utility.random.seed(seed)
    target, source, pairs = _clouds(matches)
    option = registration.FastGlobalRegistrationOption(
        maximum_correspondence_distance=config.noise_bound_m, tuple_test=True
    )
    result = registration.registration_fgr_based_on_correspondence(source, target, pairs, option)
    return _one_pose(matches, result.transformation[:3, :3], result.transformation[:3, 3])


def _clouds(matches: Correspondences) -> tuple[Any, Any, Any]:
    """Return the points of both sides as clouds, and their pairs, as types of Open3D."""
    target, source = (
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        for points in (matches.target_points_m, matches.source_points_m)
    )
    index = np.arange(len(matches), dtype=np.int32)
    return target, source, o3d.utility.Vector2iVector(np.stack([index, index], axis=1))


def solve_by_kiss_matcher(matches: Correspondences, config: CoarseConfig, seed: int) -> Solution:
    """Solve by KISS-Matcher's `prune_and_solve` (Lim et al., ICRA 2025): k-core pruning, then GNC.

    Raises:
        MissingDependencyError: the package `kiss-matcher` is not installed.
    """
    del seed
    with needed_for("The solver 'kiss_matcher'", "kiss_matcher", instead="set coarse.solver=cliques"):
        import kiss_matcher
    settings = kiss_matcher.KISSMatcherConfig(config.noise_bound_m)
    solution = kiss_matcher.KISSMatcher(settings).prune_and_solve(
        list(matches.source_points_m.astype(np.float32)), list(matches.target_points_m.astype(np.float32))
    )
    return _one_pose(matches, solution.rotation, solution.translation) if solution.valid else Solution()


def _one_pose(matches: Correspondences, rotation: FloatArray, translation: FloatArray) -> Solution:
    flat = np.asarray(translation, dtype=np.float64).reshape(3)
    return Solution(
        (RigidTransform.from_rotation_translation(matches.target, matches.source, np.asarray(rotation), flat),)
    )
