# SPDX-License-Identifier: Apache-2.0
"""Solvers of other libraries: KISS-Matcher, TEASER++."""

import numpy as np

from multilica.config import CoarseConfig
from multilica.optional_libraries import needed_for
from multilica.results import Correspondences
from multilica.solvers.solution import Solution, pose_of


def solve_by_kiss_matcher(matches: Correspondences, config: CoarseConfig) -> Solution:
    """Solve by KISS-Matcher's `prune_and_solve` (Lim et al., ICRA 2025): k-core pruning, then GNC.

    Raises:
        MissingDependencyError: the package `kiss-matcher` is not installed.
    """
    with needed_for("The solver 'kiss_matcher'", "kiss_matcher", instead="set coarse.solver=cliques"):
        import kiss_matcher
    settings = kiss_matcher.KISSMatcherConfig(config.noise_bound_m)
    solution = kiss_matcher.KISSMatcher(settings).prune_and_solve(
        list(matches.source_points_m.astype(np.float32)), list(matches.target_points_m.astype(np.float32))
    )
    if not solution.valid:
        return Solution()
    return Solution((pose_of(matches, solution.rotation, solution.translation),))


def solve_by_teaserpp(matches: Correspondences, config: CoarseConfig) -> Solution:
    """Solve by TEASER++'s own Python binding.

    Raises:
        MissingDependencyError: `teaserpp_python` is not installed.
    """
    with needed_for("The solver 'teaserpp'", "teaserpp_python", instead="set coarse.solver=maximum_clique"):
        from teaserpp_python import RobustRegistrationSolver

    params = RobustRegistrationSolver.Params()
    params.noise_bound = config.noise_bound_m
    params.cbar2 = config.cbar2
    params.estimate_scaling = False
    params.rotation_estimation_algorithm = RobustRegistrationSolver.ROTATION_ESTIMATION_ALGORITHM.GNC_TLS
    params.rotation_gnc_factor = config.gnc_factor
    params.rotation_max_iterations = config.gnc_max_iterations
    params.rotation_cost_threshold = config.gnc_cost_threshold
    solver = RobustRegistrationSolver(params)
    solver.solve(matches.source_points_m.T, matches.target_points_m.T)
    edges, clique_size = int(np.count_nonzero(solver.getScaleInliersMask())), len(solver.getInlierMaxClique())
    if clique_size < 2:
        return Solution((), edges, clique_size)
    solution = solver.getSolution()
    return Solution((pose_of(matches, solution.rotation, solution.translation),), edges, clique_size)
