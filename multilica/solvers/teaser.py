# SPDX-License-Identifier: Apache-2.0
"""TEASER++ (Yang, Shi and Carlone, T-RO 2020): its own binding, and the same from packages of the index."""

import numpy as np
from scipy.spatial.distance import cdist

from multilica.config import CoarseConfig
from multilica.geometry import RigidTransform
from multilica.optional_libraries import needed_for, require_library
from multilica.results import BoolArray, Correspondences
from multilica.solvers.decoupled_pose import decoupled_pose
from multilica.solvers.maximum_clique import maximum_clique
from multilica.solvers.solution import Solution

# Rows of the graph that are computed at once, so that memory stays bounded.
_BLOCK = 256


def solve_by_maximum_clique(matches: Correspondences, config: CoarseConfig, seed: int) -> Solution:
    """Solve as TEASER++ does, without scale: the largest clique of consistent matches, its rotation, its translation.

    Of several cliques as large, TEASER++ may take another one.

    Raises:
        MissingDependencyError: NetworkX is not installed.
    """
    del seed
    require_library("The solver 'maximum_clique'", "networkx", instead="set coarse.solver=cliques")
    graph = _length_graph(matches, 2.0 * config.noise_bound_m * np.sqrt(config.cbar2))
    edges = int(np.count_nonzero(graph)) // 2
    clique = maximum_clique(graph)
    if len(clique) < 2:
        return Solution((), edges, len(clique))
    rotation, translation = decoupled_pose(matches.target_points_m[clique], matches.source_points_m[clique], config)
    return Solution((_pose(matches, rotation, translation),), edges, len(clique))


def _length_graph(matches: Correspondences, tolerance_m: float) -> BoolArray:
    """Connect two matches (M, M) if their distances in both clouds differ by no more than the tolerance."""
    target_m, source_m = matches.target_points_m, matches.source_points_m
    graph = np.empty((len(matches), len(matches)), dtype=np.bool_)
    for start in range(0, len(matches), _BLOCK):
        rows = slice(start, start + _BLOCK)
        difference_m = np.abs(cdist(target_m[rows], target_m) - cdist(source_m[rows], source_m))
        np.less_equal(difference_m, tolerance_m, out=graph[rows])
    np.fill_diagonal(graph, val=False)
    return graph


def solve_by_teaserpp(matches: Correspondences, config: CoarseConfig, seed: int) -> Solution:
    """Solve by TEASER++'s own Python binding.

    Raises:
        MissingDependencyError: `teaserpp_python` is not installed.
    """
    del seed
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
    return Solution((_pose(matches, solution.rotation, solution.translation),), edges, clique_size)


def _pose(matches: Correspondences, rotation: object, translation: object) -> RigidTransform:
    flat = np.asarray(translation, dtype=np.float64).reshape(3)
    return RigidTransform.from_rotation_translation(
        matches.target, matches.source, np.asarray(rotation, dtype=np.float64), flat
    )
