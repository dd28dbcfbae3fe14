# SPDX-License-Identifier: Apache-2.0
"""Solvers that turn matches with many outliers into poses, all with one signature."""

from collections.abc import Callable, Mapping
from importlib.util import find_spec

from multilica.config import CoarseConfig
from multilica.results import Correspondences, Solution
from multilica.solvers.cliques import solve_by_cliques
from multilica.solvers.kiss_matcher import solve_by_kiss_matcher
from multilica.solvers.teaser import solve_by_maximum_clique, solve_by_teaserpp

__all__ = ["SOLVERS", "solver_in_use"]

SOLVERS: Mapping[str, Callable[[Correspondences, CoarseConfig], Solution]] = {
    "cliques": solve_by_cliques,
    "maximum_clique": solve_by_maximum_clique,
    "teaserpp": solve_by_teaserpp,
    "kiss_matcher": solve_by_kiss_matcher,
}
"""Each takes at least one match."""


def solver_in_use(config: CoarseConfig) -> str:
    """Name the solver that runs: `maximum_clique` for `teaserpp` where `teaserpp_python` is not installed."""
    if config.solver == "teaserpp" and find_spec("teaserpp_python") is None:
        return "maximum_clique"
    return config.solver
