# SPDX-License-Identifier: Apache-2.0
"""Judge the hypotheses of a pair by what the beams of both sensors prove."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from multilica.config import FineConfig, VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import PRIOR, Assessment, CoarseResult, Hypothesis
from multilica.stages.decide import hopeless_below, max_violation_share
from multilica.stages.gicp import register_narrower
from multilica.stages.observability import weakest_curvature
from multilica.stages.poses import is_distinct, slid, within_reach
from multilica.stages.registration_cloud import RegistrationCloud
from multilica.stages.rivals import turned_rivals
from multilica.stages.witness import Witness, judge
from multilica.testimony import Testimony

__all__ = ["assess_hypotheses", "short_gicp"]

# Rivals come from plans with cells of half a metre, or are steps of one metre apart.
_RIVAL_TOLERANCE_M = 0.6


def short_gicp(config: VerifyConfig, fine: FineConfig) -> FineConfig:
    """The settings of the short GICP: coarse grid, few iterations, loose convergence."""
    return fine.model_copy(
        update={
            "engine": "small_gicp",
            "voxel_size_m": config.voxel_size_m,
            "max_points": config.max_points,
            "max_correspondence_distances_m": (2.0, 1.0, 0.5),
            "max_iterations": config.max_iterations,
            "translation_epsilon_m": 1e-3,
            "rotation_epsilon_rad": 1e-3,
            "fitness_distance_m": 0.5,
        }
    )


def assess_hypotheses(
    target: tuple[Witness, RegistrationCloud],
    source: tuple[Witness, RegistrationCloud],
    coarse: CoarseResult,
    config: VerifyConfig,
    gicp: FineConfig,
    threads: int,
) -> tuple[Assessment, ...]:
    """Give each hypothesis a short GICP, then ask the beams of both sensors.

    A beam that returned from 20 m proves that the 20 m before it are empty: points that a pose puts there violate,
    points that it puts on measured surfaces agree, points behind surfaces say nothing. Hypotheses that start where
    an earlier one ended are the same answer and cost nothing; the rest is left out once one is clearly right. Rivals
    of the best are tried as well: turned by right angles, and along its weakest direction if it is not firmly held.

    The prior has no say in which of the others are tried: where a scene looks alike both ways, a
    wrong prior could else end the search before the true pose has its turn.

    Args:
        target, source: what both sensors testify, with a thinned cloud each for GICP.
        gicp: the settings of `short_gicp`.

    Returns:
        The distinct answers, the one with the most evidence first.
    """
    claimed: list[Assessment] = []
    found: list[Assessment] = []
    for index, hypothesis in enumerate(coarse.hypotheses):
        tried = claimed if hypothesis.origin == PRIOR else found
        if tried is found and _is_settled(found, config):
            continue
        if not is_distinct(hypothesis.T_target_source, (other.T_target_source for other in tried)):
            continue
        for assessment in _tried(target, source, index, hypothesis, config, gicp, threads):
            if is_distinct(assessment.T_target_source, (other.T_target_source for other in tried)):
                tried.append(assessment)
    for assessment in claimed:
        found = _joined(found, assessment)
    for index, hypothesis, settings in _rivals(target[0], source[0], found, config, gicp):
        pose = hypothesis.T_target_source
        if is_distinct(pose, (other.T_target_source for other in found)) and _may_win(
            _testimony(target[0], source[0], pose, _RIVAL_TOLERANCE_M, config.tolerance_deg), found, config
        ):
            found = _joined(found, _assess(target, source, index, hypothesis, config, settings, threads))
    return tuple(sorted(within_reach(found, config.rival_reach_m), key=lambda assessment: -assessment.evidence))


def _joined(found: Sequence[Assessment], further: Assessment) -> list[Assessment]:
    """The answers with one more: an answer of its own, or the better one of those that are the same."""
    same = [other for other in found if not is_distinct(further.T_target_source, [other.T_target_source])]
    if any(other.evidence >= further.evidence for other in same):
        return list(found)
    return [further, *(other for other in found if other not in same)]


def _rivals(
    target: Witness, source: Witness, found: Sequence[Assessment], config: VerifyConfig, gicp: FineConfig
) -> list[tuple[int, Hypothesis, FineConfig]]:
    """Poses that may look as good as the best one: turned in a scene of right angles, or slid along if held loosely.

    With the settings of their GICP: a turned pose is off by less than a cell, one that slides finds back from afar.
    """
    best = max(within_reach(found, config.rival_reach_m), key=lambda assessment: assessment.evidence, default=None)
    if best is None or best.testimony.agree < config.min_agree:
        return []
    up = best.testimony.commonest_normal
    near = gicp.model_copy(update={"max_correspondence_distances_m": gicp.max_correspondence_distances_m[1:]})
    turned = turned_rivals(target, source, best.T_target_source, up, config.rival_reach_m, config.rivals)
    along = slid(best, config) if best.testimony.held_by < config.firmly_held_by else []
    nothing = np.zeros(0, dtype=bool)
    return [
        (best.hypothesis, Hypothesis(pose, nothing, 0.0, best.origin), settings)
        for poses, settings in ((turned, near), (along, gicp))
        for pose in poses
    ]


def _tried(
    target: tuple[Witness, RegistrationCloud],
    source: tuple[Witness, RegistrationCloud],
    index: int,
    hypothesis: Hypothesis,
    config: VerifyConfig,
    gicp: FineConfig,
    threads: int,
) -> list[Assessment]:
    """The hypothesis after GICP; for one that GICP carried off also where a second try among near points is better.

    Narrow views share few points: of those within 2 m most may be no matches, and draw even the true pose away.
    """
    far = _assess(target, source, index, hypothesis, config, gicp, threads)
    if not is_distinct(far.T_target_source, [hypothesis.T_target_source]):
        return [far]
    nearest_only = gicp.model_copy(update={"max_correspondence_distances_m": gicp.max_correspondence_distances_m[-1:]})
    near = _assess(target, source, index, hypothesis, config, nearest_only, threads)
    return [near, far] if near.evidence > max(far.evidence, 0.0) else [far]


def _assess(
    target: tuple[Witness, RegistrationCloud],
    source: tuple[Witness, RegistrationCloud],
    index: int,
    hypothesis: Hypothesis,
    config: VerifyConfig,
    gicp: FineConfig,
    threads: int,
) -> Assessment:
    start = hypothesis.T_target_source
    registration = register_narrower(target[1], source[1], start, gicp, threads)
    forth = registration.target == start.target
    pose = registration.T_target_source if forth else registration.T_target_source.inverse()
    testimony = _testimony(target[0], source[0], pose, config.tolerance_m, config.tolerance_deg)
    return Assessment(
        hypothesis=index,
        T_target_source=pose,
        testimony=testimony,
        fitness=registration.fitness,
        rmse_m=registration.rmse_m,
        weakest_curvature=weakest_curvature(registration),
        probes_m=source[0].probes_m,
        origin=hypothesis.origin,
        target_probes_m=target[0].probes_m,
    )


def _testimony(
    target: Witness, source: Witness, pose: RigidTransform, tolerance_m: float, tolerance_deg: float
) -> Testimony:
    here = [(RigidTransform.identity(pose.target, pose.target), target)]
    there = [(RigidTransform.identity(pose.source, pose.source), source)]
    return judge(here, there, pose, tolerance_m, tolerance_deg)


def _may_win(roughly: Testimony, found: Sequence[Assessment], config: VerifyConfig) -> bool:
    """Whether a pose that is off by no more than the tolerance it was judged with can come near the best."""
    best = max(assessment.evidence for assessment in within_reach(found, config.rival_reach_m))
    return roughly.evidence > hopeless_below(best, config)


def _is_settled(found: Sequence[Assessment], config: VerifyConfig) -> bool:
    """Whether one answer stands out so far that the hypotheses left, which have fewer matches, need no trial."""
    found = within_reach(found, config.rival_reach_m)
    if len(found) < 2:
        return False
    best, second = sorted(found, key=lambda assessment: -assessment.evidence)[:2]
    firm = best.testimony.held_by >= config.firmly_held_by
    return (
        len(found) >= (config.settled_after_firm if firm else config.settled_after)
        and best.evidence > 0
        and second.evidence <= config.settled_ratio * best.evidence
        and best.testimony.violation_share <= max_violation_share(best.testimony, config)
        and best.weakest_curvature >= 2.0 * config.min_curvature
    )
