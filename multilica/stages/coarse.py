# SPDX-License-Identifier: Apache-2.0
"""Find the poses that a set of matches supports."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from multilica.config import CoarseConfig
from multilica.geometry import RigidTransform
from multilica.results import PRIOR, CoarseResult, Correspondences, Hypothesis
from multilica.stages.poses import is_distinct
from multilica.stages.solvers import SOLVERS, PoseCandidates

__all__ = ["find_hypotheses"]

# Coarse poses as near as this run into the same GICP basin: one stands for all.
_DISTINCT_M = 0.5
_DISTINCT_RAD = float(np.deg2rad(5.0))

_MIN_MATCHES = 3


def find_hypotheses(
    matches: Correspondences, config: CoarseConfig, seed: int, prior: RigidTransform | None = None
) -> CoarseResult:
    """Distinct poses of the source in the target frame, the one with the most agreeing matches first.

    Args:
        matches: putative matches, of which 95 % and more may be wrong.
        config: names the solver and bounds its answers.
        seed: for the solvers that draw at random.
        prior: a pose that is known beforehand; one more hypothesis behind the others.

    Raises:
        MissingDependencyError: the solver asked for is not installed.
    """
    plausible = _within_baseline(matches, config.max_baseline_m)
    claims = [] if prior is None else [_supported(prior, matches, config, PRIOR)]
    claimed = tuple(hypothesis for hypothesis in claims if _distance_m(hypothesis) <= config.max_baseline_m)
    if len(plausible) < _MIN_MATCHES:
        return CoarseResult(matches.target, matches.source, claimed, graph_nodes=len(plausible))
    found: PoseCandidates = SOLVERS[config.solver](matches.subset(plausible), config, seed)
    hypotheses = [
        _supported(RigidTransform(matches.target, matches.source, pose), matches, config, config.solver)
        for pose in found.poses
    ]
    near = [hypothesis for hypothesis in hypotheses if _distance_m(hypothesis) <= config.max_baseline_m]
    hypotheses_kept = _distinct(near, config.max_hypotheses) + claimed
    return CoarseResult(matches.target, matches.source, hypotheses_kept, found.graph_nodes, found.graph_edges)


def _within_baseline(matches: Correspondences, max_baseline_m: float) -> np.ndarray:
    """One surface point cannot be much farther from one LiDAR of a vehicle than from another."""
    target_range_m = np.linalg.norm(matches.target_points_m, axis=1)
    source_range_m = np.linalg.norm(matches.source_points_m, axis=1)
    return np.flatnonzero(np.abs(target_range_m - source_range_m) <= max_baseline_m)


def _supported(pose: RigidTransform, matches: Correspondences, config: CoarseConfig, origin: str) -> Hypothesis:
    residual_m = np.linalg.norm(pose.apply(matches.source_points_m) - matches.target_points_m, axis=1)
    cosine = np.einsum("ij,ij->i", pose.rotate(matches.source_normals), matches.target_normals)
    agree = (residual_m <= config.noise_bound_m) & (cosine >= np.cos(np.deg2rad(config.normal_tolerance_deg)))
    return Hypothesis(pose, agree, score=float(agree.sum()), origin=origin)


def _distance_m(hypothesis: Hypothesis) -> float:
    return float(np.linalg.norm(hypothesis.T_target_source.xyz_m))


def _distinct(hypotheses: Iterable[Hypothesis], most: int) -> tuple[Hypothesis, ...]:
    kept: list[Hypothesis] = []
    for hypothesis in sorted(hypotheses, key=lambda candidate: -candidate.score):
        others = (other.T_target_source for other in kept)
        if is_distinct(hypothesis.T_target_source, others, _DISTINCT_M, _DISTINCT_RAD):
            kept.append(hypothesis)
        if len(kept) == most:
            break
    return tuple(kept)
