# SPDX-License-Identifier: Apache-2.0
"""Register the most believable poses of a pair, or of two groups, to the last millimetre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from multilica.config import FineConfig, RefineConfig, VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import Assessment, PairRegistration
from multilica.stages.gicp import register, register_narrower
from multilica.stages.information import pose_information
from multilica.stages.observability import examine_hold, weakest_curvature
from multilica.stages.poses import is_distinct, within_reach
from multilica.stages.registration_cloud import RegistrationCloud
from multilica.stages.witness import PlacedWitness, judge

__all__ = ["Candidate", "Side", "hopeful", "register_best"]


@dataclass(frozen=True, slots=True, eq=False)
class Side:
    """One side of a registration: a LiDAR, or a group whose poses are known.

    Args:
        name: the LiDAR, or the group's root.
        cloud: the points of all members in the frame of that name.
        draft: the same, fewer: enough to tell the finalists apart.
        witnesses: the members with their poses; empty where verification is off.
    """

    name: str
    cloud: RegistrationCloud
    draft: RegistrationCloud
    witnesses: tuple[PlacedWitness, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A pose to start from, with index and origin of the hypothesis behind it, and its evidence where that is known."""

    T_target_source: RigidTransform
    hypothesis: int
    origin: str = ""
    evidence: float | None = None


def register_best(
    target: Side,
    source: Side,
    candidates: Sequence[Candidate],
    verify: VerifyConfig,
    fine: FineConfig,
    refine: RefineConfig,
    threads: int,
) -> PairRegistration:
    """GICP on the finalists among the candidates; the one with the most evidence is registered on all points.

    Args:
        candidates: at least one, the most believable first.

    Returns:
        The narrower side is the source. `assessments` holds the distinct finalists, the best first; what holds the
        best is examined if it has enough evidence and not many points hold it in its weakest direction.
    """
    if not target.witnesses:
        first = candidates[0]
        registered = register_narrower(target.cloud, source.cloud, first.T_target_source, fine, threads)
        registered = _informed(registered, target, source, refine, threads)
        return replace(registered, hypothesis=first.hypothesis)
    if len(source.cloud.points_m) > len(target.cloud.points_m):
        target, source = source, target
        candidates = [replace(each, T_target_source=each.T_target_source.inverse()) for each in candidates]
    finished: list[Assessment] = []
    drafts: list[PairRegistration] = []
    for candidate in _finalists(target, source, candidates, verify):
        drafted = register(target.draft, source.draft, candidate.T_target_source, fine, threads)
        assessment = _assess(target, source, drafted, candidate.hypothesis, candidate.origin, verify)
        if is_distinct(assessment.T_target_source, (other.T_target_source for other in finished)):
            finished.append(assessment)
            drafts.append(drafted)
    best, *others = sorted(within_reach(finished, verify.rival_reach_m), key=lambda each: -each.evidence)
    registered = drafts[finished.index(best)]
    if best.evidence > 0.0:
        registered = register(target.cloud, source.cloud, best.T_target_source, fine, threads)
        best = _assess(target, source, registered, best.hypothesis, best.origin, verify)
    registered = _informed(registered, target, source, refine, threads)
    if best.evidence >= verify.min_evidence and best.testimony.held_by < verify.firmly_held_by:
        clouds, thinned = (target.cloud, source.cloud), (target.draft, source.draft)
        weakest = best.testimony.weakest_direction
        best = replace(best, hold=examine_hold(clouds, thinned, registered, weakest, verify.push_m, fine, threads))
    return replace(registered, hypothesis=best.hypothesis, assessments=(best, *others))


def hopeful(evidence: Sequence[float], verify: VerifyConfig) -> list[int]:
    """Indices of the answers that may still turn out to be the best, which they are judged to be now first."""
    ranked = sorted(range(len(evidence)), key=lambda index: -evidence[index])[: verify.finalists]
    if not ranked:
        return []
    best = evidence[ranked[0]]
    worst = best - max(abs(best), verify.hopeless_evidence)
    return [index for index in ranked if index == ranked[0] or evidence[index] > worst]


def _informed(
    registration: PairRegistration, first: Side, second: Side, refine: RefineConfig, threads: int
) -> PairRegistration:
    clouds = {side.name: side.cloud for side in (first, second)}
    target, source = clouds[registration.target], clouds[registration.source]
    information = pose_information(target, source, registration.T_target_source, refine, threads)
    return replace(registration, information=information)


def _finalists(target: Side, source: Side, candidates: Sequence[Candidate], verify: VerifyConfig) -> list[Candidate]:
    distinct: list[Candidate] = []
    for candidate in candidates:
        if is_distinct(candidate.T_target_source, [other.T_target_source for other in distinct]):
            distinct.append(candidate)
    if len(distinct) == 1:
        return distinct
    evidence = [_evidence(target, source, candidate, verify) for candidate in distinct]
    return [distinct[index] for index in hopeful(evidence, verify)]


def _evidence(target: Side, source: Side, candidate: Candidate, verify: VerifyConfig) -> float:
    if candidate.evidence is not None:
        return candidate.evidence
    pose = candidate.T_target_source
    return judge(target.witnesses, source.witnesses, pose, verify.tolerance_m, verify.tolerance_deg).evidence


def _assess(
    target: Side, source: Side, registered: PairRegistration, hypothesis: int, origin: str, verify: VerifyConfig
) -> Assessment:
    pose = registered.T_target_source
    testimony = judge(target.witnesses, source.witnesses, pose, verify.final_tolerance_m, verify.final_tolerance_deg)
    return Assessment(
        hypothesis=hypothesis,
        T_target_source=pose,
        testimony=testimony,
        fitness=registered.fitness,
        rmse_m=registered.rmse_m,
        weakest_curvature=weakest_curvature(registered),
        probes_m=source.witnesses[0][1].probes_m,
        origin=origin,
        target_probes_m=target.witnesses[0][1].probes_m,
    )
