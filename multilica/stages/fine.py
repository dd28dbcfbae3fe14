# SPDX-License-Identifier: Apache-2.0
"""Register the most believable poses of a pair, or of two groups, to the last millimetre."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from multilica.config import FineConfig, RefineConfig, VerifyConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import Assessment, PairRegistration
from multilica.stages.decide import hopeless_below, standing_rivals
from multilica.stages.gicp import fitness_and_rmse, register, register_narrower
from multilica.stages.observability import (
    arc_between_m,
    examine_hold,
    pushed_ends,
    weakest_curvature,
    weakest_sigmas,
)
from multilica.stages.plane_fit import fit_planes, pose_information
from multilica.stages.poses import is_distinct, slid, within_reach
from multilica.stages.registration_cloud import RegistrationCloud, prepare_registration_cloud
from multilica.stages.witness import PlacedWitness, judge

__all__ = ["Candidate", "Side", "hopeful", "prepare_side", "register_best"]


# What is surer than half of what is still accepted needs no examination of what holds it.
_UNSURE_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Side:
    """One side of a registration: a LiDAR, or a group whose poses are known.

    Args:
        name: the LiDAR, or the group's root.
        cloud: the points of all members in the frame of that name.
        witnesses: the members with their poses; empty where verification is off.
        drafting, threads: how `draft` is prepared and registered.
    """

    name: str
    cloud: RegistrationCloud
    witnesses: tuple[PlacedWitness, ...]
    drafting: FineConfig
    threads: int

    @cached_property
    def draft(self) -> RegistrationCloud:
        """The cloud with fewer points: enough to tell finalists apart."""
        if len(self.cloud.points_m) <= self.drafting.max_points:
            return self.cloud
        return prepare_registration_cloud(self.name, self.cloud.points_m, self.drafting, self.threads)


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A pose to start from, with index and origin of the hypothesis behind it, and its evidence where that is known."""

    T_target_source: RigidTransform
    hypothesis: int
    origin: str = ""
    evidence: float | None = None


def prepare_side(
    name: str,
    points_m: FloatArray,
    witnesses: Sequence[PlacedWitness],
    verify: VerifyConfig,
    fine: FineConfig,
    threads: int,
) -> Side:
    """Thin the points (N, 3) of a LiDAR or of a group, given in the frame of that name, for GICP."""
    cloud = prepare_registration_cloud(name, points_m, fine, threads)
    drafting = fine.model_copy(
        update={"max_points": verify.finalist_points, "max_iterations": min(verify.max_iterations, fine.max_iterations)}
    )
    return Side(name, cloud, tuple(witnesses), drafting, threads)


def register_best(
    target: Side,
    source: Side,
    candidates: Sequence[Candidate],
    verify: VerifyConfig,
    fine: FineConfig,
    refine: RefineConfig,
    threads: int,
    *,
    fit: bool = True,
) -> PairRegistration:
    """GICP on the finalists among the candidates; the one with the most evidence is registered on all points.

    What GICP makes of it is then fitted to the planes that both sides have in common.
    A pose that slides may have slid from one that the scene holds: GICP falls into a notch from one side only, so it
    is started all along the slide, and what it finds is taken if it has more evidence. One that stopped short of where
    it is held is taken there.

    Args:
        candidates: at least one, the most believable first.
        fit: off: without the fit to planes, and so without information.

    Returns:
        The narrower side is the source. `assessments` holds the distinct finalists, the best first; what holds the best
        is examined if it has enough evidence, and few points hold it in its weakest direction, or its sigma is more
        than half of what is accepted, or a rival stands.
    """
    if not target.witnesses:
        first = candidates[0]
        registered = register_narrower(target.cloud, source.cloud, first.T_target_source, fine, threads)
        if refine.enabled:
            clouds = {side.name: side.cloud for side in (target, source)}
            ordered = clouds[registered.target], clouds[registered.source]
            information = pose_information(*ordered, registered.T_target_source, refine, threads)
            registered = replace(registered, information=information)
        return replace(registered, hypothesis=first.hypothesis)
    if len(source.cloud.points_m) > len(target.cloud.points_m):
        target, source = source, target
        candidates = [replace(each, T_target_source=each.T_target_source.inverse()) for each in candidates]
    final = _Final(target, source, verify, fine, refine, threads, fit)
    finalists = _finalists(target, source, candidates, verify)
    drafted = len(finalists) > 1
    tried = final.drafted(finalists) if drafted else [final.registered(finalists[0])]
    best = final.examined(tried, drafted=drafted)
    if _slides(best.assessments[0], verify):
        hypothesis, origin = best.hypothesis, best.assessments[0].origin
        starts = [Candidate(pose, hypothesis, origin) for pose in slid(best.assessments[0], verify)]
        beside = final.drafted(starts, beside=[*tried, best])
        if any(each.evidence > best.evidence for each in beside):
            return max(best, final.examined([*tried, *beside], drafted=True), key=lambda each: each.evidence)
    return best


def hopeful(evidence: Sequence[float], verify: VerifyConfig) -> list[int]:
    """Indices of the answers that may still turn out to be the best, which they are judged to be now first."""
    ranked = sorted(range(len(evidence)), key=lambda index: -evidence[index])[: verify.finalists]
    if not ranked:
        return []
    needed = hopeless_below(evidence[ranked[0]], verify)
    return [index for index in ranked if index == ranked[0] or evidence[index] > needed]


@dataclass(frozen=True, slots=True, eq=False)
class _Final:
    """What the registrations of one pair, or of two groups, have in common."""

    target: Side
    source: Side
    verify: VerifyConfig
    fine: FineConfig
    refine: RefineConfig
    threads: int
    fit: bool

    def drafted(
        self, candidates: Sequence[Candidate], beside: Sequence[PairRegistration] = ()
    ) -> list[PairRegistration]:
        """Where GICP of fewer points takes the candidates: what is distinct from each other, and from others beside.

        The right ones come from a short GICP, and need few iterations. What creeps on is left unless it may win.
        """
        begun = [self._drafted(candidate, self.target.drafting) for candidate in candidates]
        needed = hopeless_below(max(each.evidence for each in (*begun, *beside)), self.verify)
        drafts: list[PairRegistration] = []
        for candidate, start in zip(candidates, begun, strict=True):
            draft = start
            if not start.converged and start.evidence > needed:
                draft = self._drafted(replace(candidate, T_target_source=start.T_target_source), self.fine)
            if is_distinct(draft.T_target_source, [other.T_target_source for other in (*beside, *drafts)]):
                drafts.append(draft)
        return drafts

    def _drafted(self, candidate: Candidate, gicp: FineConfig) -> PairRegistration:
        return self._judged(self.target.draft, self.source.draft, candidate, gicp)

    def registered(self, candidate: Candidate) -> PairRegistration:
        """Where GICP of all points takes it."""
        return self._judged(self.target.cloud, self.source.cloud, candidate, self.fine)

    def examined(self, tried: Sequence[PairRegistration], *, drafted: bool) -> PairRegistration:
        """The one with the most evidence, registered on all points, with what holds it; the others behind it.

        Args:
            drafted: the registrations tried are of fewer points.
        """
        reach_m = self.verify.rival_reach_m
        ranked = sorted(within_reach([each.assessments[0] for each in tried], reach_m), key=lambda each: -each.evidence)
        best, *others = ranked
        registered = next(each for each in tried if each.assessments[0] is best)
        if best.evidence > 0.0 and drafted:
            registered = self.registered(Candidate(best.T_target_source, best.hypothesis, best.origin))
            best = registered.assessments[0]
        if best.evidence >= self.verify.min_evidence:
            held = registered
            registered = self._fitted(held) if self.fit else held
            best = registered.assessments[0]
            if self._is_in_doubt(registered, best, others):
                registered = self._examined(held, registered)
                best = registered.assessments[0]
                others = [each for each in others if is_distinct(each.T_target_source, [best.T_target_source])]
        return replace(registered, hypothesis=best.hypothesis, assessments=(best, *others))

    def _fitted(self, registered: PairRegistration) -> PairRegistration:
        """With the pose fitted to planes and judged again, and its information."""
        clouds, (before,) = (self.target.cloud, self.source.cloud), registered.assessments[:1]
        fit = fit_planes(*clouds, registered.T_target_source, self.refine, self.threads)
        pose = fit.T_target_source
        fitness, rmse_m, inliers = fitness_and_rmse(*clouds, pose, self.fine.fitness_distance_m, self.threads)
        moved = replace(registered, T_target_source=pose, fitness=fitness, rmse_m=rmse_m, inliers=inliers)
        assessment = _assess(self.target, self.source, moved, before.hypothesis, before.origin, self.verify)
        return replace(moved, information=fit.information, assessments=(assessment,))

    def _judged(
        self, target: RegistrationCloud, source: RegistrationCloud, candidate: Candidate, gicp: FineConfig
    ) -> PairRegistration:
        registered = register(target, source, candidate.T_target_source, gicp, self.threads)
        assessment = _assess(self.target, self.source, registered, candidate.hypothesis, candidate.origin, self.verify)
        return replace(registered, hypothesis=candidate.hypothesis, assessments=(assessment,))

    def _is_in_doubt(self, registered: PairRegistration, best: Assessment, others: Sequence[Assessment]) -> bool:
        """Whether it may slide: few points hold it, it is not sure, or a rival stands, which may be the slide's end."""
        loose = best.testimony.held_by < self.verify.firmly_held_by
        sigma_m, sigma_rad = weakest_sigmas(registered.information)
        limits = (self.verify.max_sigma_m, np.deg2rad(self.verify.max_sigma_deg))
        unsure = any(
            sigma is not None and sigma > _UNSURE_SHARE * limit
            for sigma, limit in zip((sigma_m, sigma_rad), limits, strict=True)
        )
        return loose or unsure or bool(standing_rivals([best, *others], self.verify))

    def _examined(self, registered: PairRegistration, fitted: PairRegistration) -> PairRegistration:
        """The fitted one with what holds it. One that ends at the same other pose from both sides had stopped short.

        Args:
            registered: where GICP ended, which is what comes back to where it was when it is pushed.
        """
        clouds, drafts = (self.target.cloud, self.source.cloud), (self.target.draft, self.source.draft)
        thinned = None if drafts == clouds else drafts
        push_m, limit_m = self.verify.push_m, self.verify.max_pushed_off_m
        for last in (False, True):
            best, pose = registered.assessments[0], registered.T_target_source
            weakest = best.testimony.weakest_direction
            ends = pushed_ends(clouds, pose, weakest, push_m, self.fine, self.threads)
            hold = examine_hold(thinned, pose, fitted.information, ends, push_m, self.fine, self.threads)
            if last or hold.pushed_off_m <= limit_m or arc_between_m(*ends) > limit_m or is_distinct(ends[0], [pose]):
                break
            further = self.registered(Candidate(ends[0], best.hypothesis, best.origin))
            if further.evidence < best.evidence:
                break
            registered, fitted = further, self._fitted(further) if self.fit else further
        return replace(fitted, assessments=(replace(fitted.assessments[0], hold=hold),))


def _slides(best: Assessment, verify: VerifyConfig) -> bool:
    return best.hold is not None and best.hold.pushed_off_m > verify.max_pushed_off_m


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
