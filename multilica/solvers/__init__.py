# SPDX-License-Identifier: Apache-2.0
"""Solvers that turn matches with many outliers into poses, all with one signature."""

from collections.abc import Callable, Mapping

from multilica.config import CoarseConfig
from multilica.results import Correspondences
from multilica.solvers.cliques import solve_by_cliques
from multilica.solvers.open3d_solvers import solve_by_fgr, solve_by_ransac
from multilica.solvers.optional import solve_by_kiss_matcher, solve_by_teaserpp
from multilica.solvers.solver_hypotheses import SolverHypotheses

__all__ = ["SOLVERS", "Solver", "SolverHypotheses"]

Solver = Callable[[Correspondences, CoarseConfig, int], SolverHypotheses]

SOLVERS: Mapping[str, Solver] = {
    "cliques": solve_by_cliques,
    "kiss_matcher": solve_by_kiss_matcher,
    "teaserpp": solve_by_teaserpp,
    "ransac": solve_by_ransac,
    "fgr": solve_by_fgr,
}
