# SPDX-License-Identifier: Apache-2.0
"""Solvers of optional packages."""

import numpy as np

from multilica.config import CoarseConfig
from multilica.errors import MissingDependencyError
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import Correspondences
from multilica.solvers.solver_hypotheses import SolverHypotheses

__all__ = ["solve_by_kiss_matcher", "solve_by_teaserpp"]


def solve_by_kiss_matcher(matches: Correspondences, config: CoarseConfig, seed: int) -> SolverHypotheses:
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
    poses = (_matrix(solution.rotation, solution.translation),) if solution.valid else ()
    return SolverHypotheses(poses, graph_nodes=len(matches))


def solve_by_teaserpp(matches: Correspondences, config: CoarseConfig, seed: int) -> SolverHypotheses:
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
    return SolverHypotheses((_matrix(solution.rotation, solution.translation),), graph_nodes=len(matches))


def _matrix(rotation: FloatArray, translation: FloatArray) -> FloatArray:
    flat = np.asarray(translation, dtype=np.float64).reshape(3)
    return RigidTransform.from_rotation_translation("target", "source", np.asarray(rotation), flat).matrix


def _missing(solver: str, how: str) -> MissingDependencyError:
    return MissingDependencyError(
        f"The solver '{solver}' is not installed; install it with `{how}` or set coarse.solver=cliques."
    )
