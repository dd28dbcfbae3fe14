# SPDX-License-Identifier: Apache-2.0
"""Open3D's RANSAC and fast global registration on ready-made matches."""

import numpy as np
import open3d as o3d

from multilica.config import CoarseConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import Correspondences
from multilica.solvers.solver_hypotheses import SolverHypotheses

__all__ = ["solve_by_fgr", "solve_by_ransac"]

_RANSAC_ITERATIONS = 1_000_000
_RANSAC_CONFIDENCE = 0.999
_EDGE_LENGTH_SIMILARITY = 0.9


def solve_by_ransac(matches: Correspondences, config: CoarseConfig, seed: int) -> SolverHypotheses:
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
    found = result.fitness > 0.0
    return SolverHypotheses((_orthonormal(result.transformation),) if found else (), graph_nodes=len(matches))


def solve_by_fgr(matches: Correspondences, config: CoarseConfig, seed: int) -> SolverHypotheses:
    """Solve by fast global registration (Zhou et al., ECCV 2016)."""
    registration = o3d.pipelines.registration
    o3d.utility.random.seed(seed)
    target, source, pairs = _clouds(matches)
    option = registration.FastGlobalRegistrationOption(
        maximum_correspondence_distance=config.noise_bound_m, tuple_test=True
    )
    result = registration.registration_fgr_based_on_correspondence(source, target, pairs, option)
    return SolverHypotheses((_orthonormal(result.transformation),), graph_nodes=len(matches))


def _clouds(
    matches: Correspondences,
) -> tuple[o3d.geometry.PointCloud, o3d.geometry.PointCloud, o3d.utility.Vector2iVector]:
    target, source = (
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
        for points in (matches.target_points_m, matches.source_points_m)
    )
    index = np.arange(len(matches), dtype=np.int32)
    return target, source, o3d.utility.Vector2iVector(np.stack([index, index], axis=1))


def _orthonormal(matrix: FloatArray) -> FloatArray:
    return RigidTransform.from_rotation_translation("target", "source", matrix[:3, :3], matrix[:3, 3]).matrix
