# SPDX-License-Identifier: Apache-2.0
"""Solvers of other libraries: Open3D, KISS-Matcher, TEASER++."""

from typing import Any

import numpy as np

from multilica.config import CoarseConfig
from multilica.errors import MissingDependencyError
from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.lazy_open3d import o3d
from multilica.results import Correspondences

__all__ = ["solve_by_fgr", "solve_by_kiss_matcher", "solve_by_ransac", "solve_by_teaserpp"]

# As in the example of Open3D for FPFH matches, with ten times the iterations for more outliers.
_RANSAC_ITERATIONS = 1_000_000
_RANSAC_CONFIDENCE = 0.999
_EDGE_LENGTH_SIMILARITY = 0.9


def solve_by_ransac(
    matches: Correspondences, config: CoarseConfig, seed: int
) -> tuple[tuple[RigidTransform, ...], int]:
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
    return _one_pose(matches, rotation, translation) if result.fitness > 0.0 else ((), 0)


def solve_by_fgr(matches: Correspondences, config: CoarseConfig, seed: int) -> tuple[tuple[RigidTransform, ...], int]:
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


def solve_by_kiss_matcher(
    matches: Correspondences, config: CoarseConfig, seed: int
) -> tuple[tuple[RigidTransform, ...], int]:
    """Solve by KISS-Matcher's `prune_and_solve` (Lim et al., ICRA 2025): k-core pruning, then GNC.

    Raises:
        MissingDependencyError: the package `kiss-matcher` is not installed.
    """
    del seed
    try:
        import kiss_matcher
    except ImportError as error:
        raise _missing("kiss_matcher", "pip install kiss-matcher") from error
    settings = kiss_matcher.KISSMatcherConfig(config.noise_bound_m)
    solution = kiss_matcher.KISSMatcher(settings).prune_and_solve(
        list(matches.source_points_m.astype(np.float32)), list(matches.target_points_m.astype(np.float32))
    )
    return _one_pose(matches, solution.rotation, solution.translation) if solution.valid else ((), 0)


def solve_by_teaserpp(
    matches: Correspondences, config: CoarseConfig, seed: int
) -> tuple[tuple[RigidTransform, ...], int]:
    """Solve by TEASER++'s own Python binding, where the user installed it.

    Raises:
        MissingDependencyError: `teaserpp_python` is not installed.
    """
    del seed
    try:
        import teaserpp_python
    except ImportError as error:
        how = "pip install git+https://github.com/MIT-SPARK/TEASER-plusplus.git"
        raise _missing("teaserpp", how) from error
    params = teaserpp_python.RobustRegistrationSolver.Params()
    params.noise_bound = config.noise_bound_m
    params.cbar2 = 1.0
    params.estimate_scaling = False
    params.rotation_estimation_algorithm = (
        teaserpp_python.RobustRegistrationSolver.ROTATION_ESTIMATION_ALGORITHM.GNC_TLS
    )
    params.rotation_gnc_factor = 1.4
    params.rotation_max_iterations = 100
    params.rotation_cost_threshold = 1e-6
    solver = teaserpp_python.RobustRegistrationSolver(params)
    solver.solve(matches.source_points_m.T, matches.target_points_m.T)
    solution = solver.getSolution()
    return _one_pose(matches, solution.rotation, solution.translation)


def _one_pose(
    matches: Correspondences, rotation: FloatArray, translation: FloatArray
) -> tuple[tuple[RigidTransform, ...], int]:
    flat = np.asarray(translation, dtype=np.float64).reshape(3)
    pose = RigidTransform.from_rotation_translation(matches.target, matches.source, np.asarray(rotation), flat)
    return (pose,), 0


def _missing(solver: str, how: str) -> MissingDependencyError:
    return MissingDependencyError(
        f"The solver '{solver}' is not installed; install it with `{how}` or set coarse.solver=cliques."
    )
