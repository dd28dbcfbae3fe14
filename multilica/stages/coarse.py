# SPDX-License-Identifier: Apache-2.0
"""Hypotheses from the matches of a pair."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from multilica.config import CoarseConfig
from multilica.geometry import RigidTransform
from multilica.registration.poses import is_distinct, is_near
from multilica.results import PRIOR, CoarseResult, Correspondences, Hypothesis, IndexArray
from multilica.solvers import SOLVERS

__all__ = ["find_hypotheses"]

# Coarse poses as near as this converge to the same pose by GICP.
_DISTINCT_M = 0.5
_DISTINCT_RAD = float(np.deg2rad(5.0))

# Fewer points do not determine a pose.
_MIN_MATCHES = 3


def find_hypotheses(
    matches: Correspondences,
    config: CoarseConfig,
    max_baseline_m: float,
    seed: int,
    prior: RigidTransform | None = None,
) -> CoarseResult:
    """Find distinct poses of the source in the target frame, the one with the most agreeing matches first.

    Args:
        matches: putative matches, of which 95 % and more may be wrong.
        prior: a pose that is known beforehand; one more hypothesis after the others.

    Raises:
        MissingDependencyError: the configured solver is not installed.
    """
    plausible = matches.subset(_within_baseline(matches, max_baseline_m))
    enough = len(plausible) >= _MIN_MATCHES
    poses, edges = SOLVERS[config.solver](plausible, config, seed) if enough else ((), 0)
    near = [_supported(pose, matches, config, config.solver) for pose in poses if is_near(pose, max_baseline_m)]
    hypotheses = _distinct(near, config.max_hypotheses)
    if prior is not None and is_near(prior, max_baseline_m):
        hypotheses.append(_supported(prior, matches, config, PRIOR))
    numbered = tuple(replace(hypothesis, index=index) for index, hypothesis in enumerate(hypotheses))
    return CoarseResult(matches.target, matches.source, numbered, len(plausible), edges)


def _within_baseline(matches: Correspondences, max_baseline_m: float) -> IndexArray:
    """Select the matches whose ranges differ by no more than the distance of the LiDARs."""
    target_range_m = np.linalg.norm(matches.target_points_m, axis=1)
    source_range_m = np.linalg.norm(matches.source_points_m, axis=1)
    return np.flatnonzero(np.abs(target_range_m - source_range_m) <= max_baseline_m)


def _supported(pose: RigidTransform, matches: Correspondences, config: CoarseConfig, origin: str) -> Hypothesis:
    residual_m = np.linalg.norm(pose.apply(matches.source_points_m) - matches.target_points_m, axis=1)
    cosine = np.einsum("ij,ij->i", pose.rotate(matches.source_normals), matches.target_normals)
    agree = (residual_m <= config.noise_bound_m) & (cosine >= np.cos(np.deg2rad(config.normal_tolerance_deg)))
    return Hypothesis(pose, agree, score=float(agree.sum()), origin=origin)


def _distinct(hypotheses: Iterable[Hypothesis], most: int) -> list[Hypothesis]:
    kept: list[Hypothesis] = []
    for hypothesis in sorted(hypotheses, key=lambda each: -each.score):
        others = (other.T_target_source for other in kept)
        if is_distinct(hypothesis.T_target_source, others, _DISTINCT_M, _DISTINCT_RAD):
            kept.append(hypothesis)
        if len(kept) == most:
            break
    return kept
