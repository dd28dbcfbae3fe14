# SPDX-License-Identifier: Apache-2.0
"""Judge the hypotheses of a pair by what the beams of both sensors prove."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from multilica.config import FineConfig, VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import Assessment, CoarseResult, Testimony
from multilica.stages.gicp import register_narrower
from multilica.stages.observability import weakest_curvature
from multilica.stages.poses import is_distinct
from multilica.stages.registration_cloud import RegistrationCloud
from multilica.stages.witness import Witness, judge

__all__ = ["assess_hypotheses", "short_gicp"]


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
    an earlier one ended are the same answer and cost nothing; the rest is left out once one is clearly right. If the
    best is not firmly held, poses along its weakest direction are tried as well.

    Args:
        target, source: what both sensors testify, with a thinned cloud each for GICP.
        gicp: the settings of `short_gicp`.

    Returns:
        The distinct answers, the one with the most evidence first.
    """
    found: list[Assessment] = []

    def try_from(start: RigidTransform, hypothesis: int) -> None:
        if not is_distinct(start, (other.T_target_source for other in found)):
            return
        assessment = _assess(target, source, start, hypothesis, config, gicp, threads)
        if is_distinct(assessment.T_target_source, (other.T_target_source for other in found)):
            found.append(assessment)

    for index, hypothesis in enumerate(coarse.hypotheses):
        try_from(hypothesis.T_target_source, index)
        if _is_settled(found, config):
            break
    best = max(found, key=lambda assessment: assessment.evidence, default=None)
    if best is not None and _may_have_slid(best.testimony, config):
        for slid in _slides(best, config):
            try_from(slid, best.hypothesis)
    return tuple(sorted(found, key=lambda assessment: -assessment.evidence))


def _may_have_slid(testimony: Testimony, config: VerifyConfig) -> bool:
    return testimony.agree >= config.min_agree and testimony.held_by < config.firmly_held_by


def _slides(assessment: Assessment, config: VerifyConfig) -> Iterator[RigidTransform]:
    """The pose shifted along its weakest direction: where facades or pillars repeat, the true one may be steps away."""
    pose, direction = assessment.T_target_source, assessment.testimony.slide_direction
    for step in range(1, config.slides + 1):
        for side in (-1.0, 1.0):
            xyz_m = pose.xyz_m + side * step * config.slide_step_m * direction
            yield RigidTransform.from_rotation_translation(pose.target, pose.source, pose.rotation, xyz_m)


def _assess(
    target: tuple[Witness, RegistrationCloud],
    source: tuple[Witness, RegistrationCloud],
    start: RigidTransform,
    hypothesis: int,
    config: VerifyConfig,
    gicp: FineConfig,
    threads: int,
) -> Assessment:
    registration = register_narrower(target[1], source[1], start, gicp, threads)
    forth = registration.target == start.target
    pose = registration.T_target_source if forth else registration.T_target_source.inverse()
    here = [(RigidTransform.identity(start.target, start.target), target[0])]
    there = [(RigidTransform.identity(start.source, start.source), source[0])]
    testimony = judge(here, there, pose, config.tolerance_m, config.tolerance_deg)
    return Assessment(
        hypothesis=hypothesis,
        T_target_source=pose,
        testimony=testimony,
        fitness=registration.fitness,
        rmse_m=registration.rmse_m,
        weakest_curvature=weakest_curvature(registration),
        probes_m=source[0].probes_m,
    )


def _is_settled(found: Sequence[Assessment], config: VerifyConfig) -> bool:
    """Whether one answer stands out so far that the hypotheses left, which have fewer matches, need no trial."""
    if len(found) < config.settled_after:
        return False
    best, second = sorted(found, key=lambda assessment: -assessment.evidence)[:2]
    return (
        best.evidence > 0
        and second.evidence <= config.settled_ratio * best.evidence
        and best.testimony.violation_share <= config.max_violation_share
        and best.weakest_curvature >= 2.0 * config.min_curvature
    )
