# SPDX-License-Identifier: Apache-2.0
"""Solvers that turn matches with many outliers into poses, all with one signature."""

from collections.abc import Callable, Mapping

from multilica.config import CoarseConfig
from multilica.geometry import RigidTransform
from multilica.results import Correspondences
from multilica.solvers.cliques import solve_by_cliques
from multilica.solvers.library_solvers import solve_by_fgr, solve_by_kiss_matcher, solve_by_ransac, solve_by_teaserpp

__all__ = ["SOLVERS", "Solver"]

Solver = Callable[[Correspondences, CoarseConfig, int], tuple[tuple[RigidTransform, ...], int]]
"""Takes matches, configuration and seed to poses, the most trusted first, and the consistency graph's edges (or 0)."""

SOLVERS: Mapping[str, Solver] = {
    "cliques": solve_by_cliques,
    "kiss_matcher": solve_by_kiss_matcher,
    "teaserpp": solve_by_teaserpp,
    "ransac": solve_by_ransac,
    "fgr": solve_by_fgr,
}
