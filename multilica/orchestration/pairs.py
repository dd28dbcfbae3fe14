# SPDX-License-Identifier: Apache-2.0
"""Search and registration of single pairs, as tasks for worker processes."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from multilica.acceptance.accept import accept, accept_by_fitness
from multilica.config import CalibrationConfig, Stage
from multilica.geometry import RigidTransform
from multilica.orchestration.prepared_lidar import PreparedLidar
from multilica.results import CoarseResult, Correspondences, Hypothesis, PairKey, PairRegistration, Registration
from multilica.stages.coarse import find_hypotheses
from multilica.stages.correspond import match_features, pair_priority
from multilica.stages.fine import RegistrationCloud, register_best
from multilica.stages.verify import verify_hypotheses
from multilica.visibility.sensor_view import FINE_TOLERANCES, score_pose
from multilica.workers import Shared

PAIR_STAGES: tuple[Stage, ...] = ("correspond", "coarse", "verify", "fine")


@dataclass(frozen=True, slots=True)
class SearchRequest:
    """A pair to search.

    Args:
        voxel_size_m: of the descriptors.
        prior: a pose that is known beforehand.
        until: the last stage to run, one of `PAIR_STAGES`.
    """

    pair: PairKey
    voxel_size_m: float
    prior: RigidTransform | None = None
    until: Stage = "fine"


@dataclass(slots=True, eq=False)
class PairSearch:
    """Results of the stages for a pair, up to the last stage that ran.

    Args:
        verified: None where verification is off.
        registration: None if there is no hypothesis.
        elapsed_s: of each stage.
    """

    matches: Correspondences
    coarse: CoarseResult | None = None
    verified: tuple[Registration, ...] | None = None
    registration: PairRegistration | None = None
    elapsed_s: dict[Stage, float] = field(default_factory=dict)


def priority_of(lidars: Shared, pair: PairKey) -> float:
    """Estimate how likely a search of the pair succeeds."""
    target, source = (lidars[name] for name in pair)
    config = target.config
    return pair_priority(target.features, source.features, config.coarse, config.acceptance.max_baseline_m)


def search_pair(lidars: Shared | Mapping[str, PreparedLidar], request: SearchRequest) -> PairSearch:
    """Search the pose of a pair without an initial guess: match, find hypotheses, verify them, register the best."""
    target, source = (lidars[name] for name in request.pair)
    config = target.config
    stages = PAIR_STAGES[: PAIR_STAGES.index(request.until) + 1]
    clock = _Clock()
    of_target, of_source = (each.features_at(request.voxel_size_m) for each in (target, source))
    found = PairSearch(match_features(of_target, of_source, config.correspond))
    clock.stop("correspond", found)
    if "coarse" in stages:
        limits = config.coarse, config.acceptance.max_baseline_m
        found.coarse = find_hypotheses(found.matches, *limits, request.prior)
        clock.stop("coarse", found)
    if "verify" in stages and found.coarse is not None and config.verify.enabled:
        found.verified = verify_hypotheses(target.verification_cloud, source.verification_cloud, found.coarse, config)
        clock.stop("verify", found)
    if "fine" in stages and found.coarse is not None:
        hypotheses = found.coarse.hypotheses if found.verified is None else _as_hypotheses(found.verified)
        if hypotheses:
            found.registration = register_sides(target.side, source.side, hypotheses, config)
        clock.stop("fine", found)
    return found


def register_implied(lidars: Shared, implied: Hypothesis) -> PairRegistration:
    """Register two LiDARs from the pose that other pairs imply."""
    pose = implied.T_target_source
    target, source = (lidars[name] for name in (pose.target, pose.source))
    return register_sides(target.side, source.side, [implied], target.config)


def score_implied(lidars: Shared, pose: RigidTransform) -> Registration:
    """Score a pose between two LiDARs by their beams."""
    target, source = (lidars[name] for name in (pose.target, pose.source))
    return score_pose(target.verification_cloud.view, source.verification_cloud.view, pose, *FINE_TOLERANCES)


def register_sides(
    target: RegistrationCloud,
    source: RegistrationCloud,
    hypotheses: Sequence[Hypothesis],
    config: CalibrationConfig,
    *,
    fit: bool = True,
) -> PairRegistration:
    """Register two sides as `register_best` does, with a verdict."""
    found = register_best(target, source, hypotheses, config, fit=fit)
    if found.registrations:
        return replace(found, verdict=accept(found.registrations, config.acceptance))
    return replace(found, verdict=accept_by_fitness(found, config.merge))


def _as_hypotheses(registrations: Sequence[Registration]) -> list[Hypothesis]:
    return [
        Hypothesis(
            each.T_target_source,
            origin=each.origin,
            index=each.hypothesis,
            evidence=each.evidence,
            derivation=each.derivation,
        )
        for each in registrations
    ]


class _Clock:
    """Time since the last stop."""

    def __init__(self) -> None:
        self._since_s = time.perf_counter()

    def stop(self, stage: Stage, found: PairSearch) -> None:
        """Note the time as that of the stage."""
        now_s = time.perf_counter()
        found.elapsed_s[stage], self._since_s = now_s - self._since_s, now_s
