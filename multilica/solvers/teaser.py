# SPDX-License-Identifier: Apache-2.0
"""TEASER++: its own binding, and the same from packages of the index.

Yang, Shi and Carlone, "TEASER: Fast and Certifiable Point Cloud Registration", T-RO 2020.
"""

import numpy as np
from scipy.spatial.distance import cdist

from multilica.config import CoarseConfig
from multilica.geometry import FloatArray
from multilica.optional_libraries import needed_for, require_library
from multilica.results import BoolArray, Correspondences, Solution
from multilica.solvers.consistency_graph import maximum_clique

# Rows of the graph that are computed at once, so that memory stays bounded.
_BLOCK = 256
# Graduated non-convexity of the rotation, as the published code of the paper sets it: the cost becomes sharper by the
# factor until it changes by less.
_GNC_FACTOR = 1.4
_GNC_ITERATIONS = 10_000
_GNC_COST_THRESHOLD_M2 = 1e-16
# Far beyond it every weight is 0 or 1, so that it need not grow on until it overflows.
_SHARPEST = 1e100


def solve_by_maximum_clique(matches: Correspondences, config: CoarseConfig) -> Solution:
    """Solve as TEASER++ does, without scale: the largest clique of consistent matches, its rotation, its translation.

    Among several cliques of one size, TEASER++ may take another one.

    Raises:
        MissingDependencyError: NetworkX is not installed.
    """
    require_library("The solver 'maximum_clique'", "networkx", instead="set coarse.solver=cliques")
    graph = _length_graph(matches, 2.0 * config.noise_bound_m)
    edges = int(np.count_nonzero(graph)) // 2
    clique = maximum_clique(graph)
    if len(clique) < 2:
        return Solution((), edges, len(clique))
    rotation, translation = decoupled_pose(
        matches.target_points_m[clique], matches.source_points_m[clique], config.noise_bound_m
    )
    return Solution((matches.pose(rotation, translation),), edges, len(clique))


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


def solve_by_teaserpp(matches: Correspondences, config: CoarseConfig) -> Solution:
    """Solve by TEASER++'s own Python binding.

    Raises:
        MissingDependencyError: `teaserpp_python` is not installed.
    """
    with needed_for("The solver 'teaserpp'", "teaserpp_python", instead="set coarse.solver=maximum_clique"):
        from teaserpp_python import RobustRegistrationSolver

    params = RobustRegistrationSolver.Params()
    params.noise_bound = config.noise_bound_m
    params.cbar2 = 1.0
    params.estimate_scaling = False
    params.rotation_estimation_algorithm = RobustRegistrationSolver.ROTATION_ESTIMATION_ALGORITHM.GNC_TLS
    params.rotation_gnc_factor = _GNC_FACTOR
    params.rotation_max_iterations = _GNC_ITERATIONS
    params.rotation_cost_threshold = _GNC_COST_THRESHOLD_M2
    solver = RobustRegistrationSolver(params)
    solver.solve(matches.source_points_m.T, matches.target_points_m.T)
    edges, clique_size = int(np.count_nonzero(solver.getScaleInliersMask())), len(solver.getInlierMaxClique())
    if clique_size < 2:
        return Solution((), edges, clique_size)
    solution = solver.getSolution()
    return Solution((matches.pose(solution.rotation, solution.translation),), edges, clique_size)


def decoupled_pose(target_m: FloatArray, source_m: FloatArray, noise_bound_m: float) -> tuple[FloatArray, FloatArray]:
    """Estimate the rotation from a ring of differences, then each component of the translation (sections V to VII).

    Args:
        target_m, source_m: (N, 3) matched points in the order of the ring, N >= 2.

    Returns:
        Rotation (3, 3) and translation (3,).
    """
    ring_target_m, ring_source_m = (np.roll(points, -1, axis=0) - points for points in (target_m, source_m))
    # A difference has the noise of two points.
    rotation = _robust_rotation(ring_target_m, ring_source_m, 2.0 * noise_bound_m)
    offsets_m = target_m - source_m @ rotation.T
    return rotation, np.array([vote_translation(along, noise_bound_m) for along in offsets_m.T])


def _robust_rotation(target_m: FloatArray, source_m: FloatArray, noise_bound_m: float) -> FloatArray:
    """Rotate (N, 3) vectors onto others by graduated non-convexity on a truncated cost (Yang et al., RA-L 2020)."""
    bound_m2 = noise_bound_m**2
    weights = np.ones(len(target_m))
    rotation, sharpness, cost_before = np.eye(3), 0.0, np.inf
    for _ in range(_GNC_ITERATIONS):
        rotation = _rotation(target_m, source_m, weights)
        squared_m2 = np.sum((target_m - source_m @ rotation.T) ** 2, axis=1)
        if sharpness == 0.0:
            excess = 2.0 * squared_m2.max() / bound_m2 - 1.0
            if excess <= 0.0:
                break
            sharpness = 1.0 / excess
        cost = float(weights @ squared_m2)
        between = np.sqrt(bound_m2 * sharpness * (sharpness + 1.0) / np.maximum(squared_m2, 1e-300)) - sharpness
        outside = squared_m2 >= (sharpness + 1.0) / sharpness * bound_m2
        inside = squared_m2 <= sharpness / (sharpness + 1.0) * bound_m2
        weights = np.where(outside, 0.0, np.where(inside, 1.0, between))
        if abs(cost - cost_before) < _GNC_COST_THRESHOLD_M2:
            break
        sharpness, cost_before = min(sharpness * _GNC_FACTOR, _SHARPEST), cost
    return rotation


def _rotation(target_m: FloatArray, source_m: FloatArray, weights: FloatArray) -> FloatArray:
    """Fit the rotation (3, 3) of (N, 3) vectors with ``target ~ R @ source`` and weights (N,)."""
    u, _, vt = np.linalg.svd(target_m.T @ (source_m * weights[:, None]))
    u[:, -1] *= np.linalg.det(u @ vt)
    return np.asarray(u @ vt)


def vote_translation(offsets_m: FloatArray, bound_m: float) -> float:
    """Estimate one component of the translation from the offsets (N,) of the matches by adaptive voting.

    The sets of offsets within the bound of one place change only at the ends of their intervals, so one place between
    each two ends is tried. TEASER++ adds the bound, not its square, for each offset that is left out.

    Returns:
        The mean of the set with the least cost, metres.
    """
    ends_m = np.sort(np.concatenate([offsets_m - bound_m, offsets_m + bound_m]))
    centres_m = (ends_m[:-1] + ends_m[1:]) / 2.0
    within = np.abs(offsets_m - centres_m[:, None]) <= bound_m
    count = np.count_nonzero(within, axis=1)
    within, count = within[count > 0], count[count > 0]
    mean_m = (within @ offsets_m) / count
    spread = np.sum(np.where(within, offsets_m - mean_m[:, None], 0.0) ** 2, axis=1)
    return float(mean_m[np.argmin(spread + bound_m * (len(offsets_m) - count))])
