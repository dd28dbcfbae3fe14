# SPDX-License-Identifier: Apache-2.0
"""The built-in solver: one pose per maximal clique of consistent matches."""

import numpy as np

from multilica.config import CoarseConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import Correspondences
from multilica.solvers.consistency_graph import build_consistency_graph, grow_cliques
from multilica.solvers.robust_pose import align_points, robust_poses

__all__ = ["solve_by_cliques"]

# Several cliques lead to the same pose, so more are grown than hypotheses are asked for.
_SEEDS_PER_HYPOTHESIS = 4
# Matches agree by chance in much smaller cliques than the largest.
_SMALLEST_SHARE = 0.2
_REFITS = 3


def solve_by_cliques(
    matches: Correspondences, config: CoarseConfig, seed: int
) -> tuple[tuple[RigidTransform, ...], int]:
    """Solve by TEASER++'s method (Yang et al., T-RO 2020), extended to several hypotheses.

    Build a consistency graph on invariant lengths and angles; find maximal cliques instead of the one maximum clique;
    estimate GNC-TLS rotation and TLS translation on each; then fit by least squares to all matches that agree.
    """
    del seed
    graph = build_consistency_graph(matches, config.noise_bound_m, config.normal_tolerance_deg)
    seeds = 1 if config.max_hypotheses == 1 else _SEEDS_PER_HYPOTHESIS * config.max_hypotheses
    cliques = grow_cliques(graph, seeds)
    smallest = max(3.0, _SMALLEST_SHARE * max(map(len, cliques), default=0))
    cliques = [clique for clique in cliques if len(clique) >= smallest]
    members_m = [(matches.target_points_m[clique], matches.source_points_m[clique]) for clique in cliques]
    starts = robust_poses(members_m, config.noise_bound_m)
    return tuple(_refitted(matches, *start, config.noise_bound_m) for start in starts), graph.edges


def _refitted(
    matches: Correspondences, rotation: FloatArray, translation: FloatArray, noise_bound_m: float
) -> RigidTransform:
    target_m, source_m = matches.target_points_m, matches.source_points_m
    for _ in range(_REFITS):
        residual_m = np.linalg.norm(target_m - source_m @ rotation.T - translation, axis=1)
        agree = residual_m <= noise_bound_m
        if np.count_nonzero(agree) < 3:
            break
        rotation, translation = align_points(target_m[agree], source_m[agree])
    return RigidTransform.from_rotation_translation(matches.target, matches.source, rotation, translation)
