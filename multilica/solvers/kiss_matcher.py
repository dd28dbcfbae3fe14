# SPDX-License-Identifier: Apache-2.0
"""KISS-Matcher (Lim et al., ICRA 2025)."""

import numpy as np

from multilica.config import CoarseConfig
from multilica.optional_libraries import needed_for
from multilica.results import Correspondences, Solution


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
    return Solution((matches.pose(solution.rotation, solution.translation),))
