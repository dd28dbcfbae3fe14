# SPDX-License-Identifier: Apache-2.0
"""Hypotheses from the matches of a pair."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from multilica.config import CoarseConfig
from multilica.geometry import RigidTransform
from multilica.registration.poses import is_distinct, is_near
from multilica.results import PRIOR, CoarseResult, Correspondences, Hypothesis, Solution
from multilica.solvers import SOLVERS, solver_in_use

# Coarse poses as near as this converge to the same pose by GICP.
_DISTINCT_M = 0.5
_DISTINCT_RAD = float(np.deg2rad(5.0))

# Fewer points do not determine a pose.
_MIN_MATCHES = 3


def find_hypotheses(
    matches: Correspondences,
    config: CoarseConfig,
    max_baseline_m: float,
    prior: RigidTransform | None = None,
) -> CoarseResult:
    """Find distinct poses of the source in the target frame, the one with the most agreeing matches first.

    Args:
        matches: putative matches; 95 % and more may be wrong.
        prior: a pose that is known beforehand; one more hypothesis after the others.

    Raises:
        MissingDependencyError: the configured solver is not installed.
    """
    plausible = matches.within_baseline(max_baseline_m)
    enough = len(plausible) >= _MIN_MATCHES
    solver = solver_in_use(config)
    found = SOLVERS[solver](plausible, config) if enough else Solution()
    near = [_supported(pose, matches, config, solver) for pose in found.poses if is_near(pose, max_baseline_m)]
    agreed = (each for each in near if each.score >= config.min_agreeing_matches)
    hypotheses = _distinct(agreed, config.max_hypotheses)
    if prior is not None and is_near(prior, max_baseline_m):
        hypotheses.append(_supported(prior, matches, config, PRIOR))
    numbered = tuple(replace(hypothesis, index=index) for index, hypothesis in enumerate(hypotheses))
    return CoarseResult(matches.target, matches.source, numbered, len(plausible), found.graph_edges, found.clique_size)


def _supported(pose: RigidTransform, matches: Correspondences, config: CoarseConfig, origin: str) -> Hypothesis:
    agree = matches.agreeing(pose, config.noise_bound_m, config.normal_tolerance_deg)
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
