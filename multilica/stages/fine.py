# SPDX-License-Identifier: Apache-2.0
"""Fine registration of a pair's finalists, or of two groups."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from multilica.acceptance.accept import (
    cannot_be_accepted,
    competing_poses,
    is_well_constrained,
    likeliest_first,
    may_compete,
    min_competing_evidence,
    slides,
    surely_competing,
)
from multilica.acceptance.placement import imprecision
from multilica.config import AcceptanceConfig, CalibrationConfig, FineConfig
from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.gicp import GicpCloud, fitness_and_rmse, register
from multilica.registration.plane_fit import PlaneFit, fit_planes, pose_information
from multilica.registration.poses import arc_between_m, is_distinct, slid_hypotheses, within_baseline
from multilica.registration.sensor_biases import prior_sigmas
from multilica.registration.stability import check_stability, perturbed_ends
from multilica.registration.widening import widened_along
from multilica.results import Hypothesis, PairRegistration, Registration, Stability, VisibilityScore
from multilica.results.registrations import weakest_sigmas
from multilica.visibility.plans import alike_hypotheses
from multilica.visibility.registration_cloud import RegistrationCloud
from multilica.visibility.sensor_view import (
    COMPETING_TOLERANCES,
    FINE_TOLERANCES,
    ROUGH_TOLERANCES,
    score_registration,
    score_visibility,
)

# A pose needs a test of stability unless this many times its sigma is below the limit.
_SIGMA_MARGIN = 2.0
# So many poses as likely as the best show that it slides: no constrained pose was found along the way.
_SLIDE_POSES = 2
# Two registrations from different sides that end as near as this end at one pose.
_SAME_END_M = 0.01
# If the fit to planes moves a known pose by less, GICP leads to the same pose: of 33 such, none differed by 1 mm.
_UNMOVED_M = 0.03


def register_best(
    target: RegistrationCloud,
    source: RegistrationCloud,
    hypotheses: Sequence[Hypothesis],
    config: CalibrationConfig,
    *,
    fit: bool = True,
    is_known: bool = False,
) -> PairRegistration:
    """Register the finalists by GICP, and the likeliest one on all points.

    The result of GICP is fitted to the planes that both sides share. If a pose slides, GICP may have missed a
    constrained pose that it finds from one side only. GICP is therefore started at steps along the slide, and the
    likeliest result is taken. A pose that stopped before a constrained one is moved there.

    Args:
        hypotheses: at least one, the most promising first.
        fit: off: without the fit to planes, and so without information.
        is_known: the first hypothesis is probably right. If the fit to planes leaves it where it is, and certain, GICP
            is not run.

    Returns:
        The narrower side is the source; where verification is off, the roles are as given. `registrations` holds the
        distinct finalists, the best first. Its stability is tested if it has enough evidence, and is not well
        constrained, or is uncertain, or has a competing pose.
    """
    if not target.views:
        return _register_first(target, source, hypotheses[0], config)
    pair, hypotheses = _of_narrower_source(target, source, hypotheses, config, fit=fit)
    if is_known and (unmoved := pair.unmoved(hypotheses[0])) is not None:
        return unmoved
    finalists = pair.finalists(hypotheses)
    evidence = finalists[0].evidence
    hopeless = evidence is not None and cannot_be_accepted(evidence, config.acceptance)
    thinned = len(finalists) > 1 or hopeless
    registered = pair.register_thinned(finalists) if thinned else [pair.register(finalists[0])]
    best = pair.best_of(registered, thinned=thinned)
    found, stability = best.registrations[0], best.registrations[0].stability
    beside_known = len(competing_poses(best.registrations, config.acceptance)) >= _SLIDE_POSES
    if stability is None or beside_known or not slides(stability, config.acceptance):
        return best
    direction, max_baseline_m = found.visibility.slide_direction, config.acceptance.max_baseline_m
    starts = slid_hypotheses(_start_of(found), direction, max_baseline_m)
    beside = pair.register_thinned(starts, beside=[*registered, best])
    if any(found.lead_over(each.registrations[0]) < 0.0 for each in beside):
        other = pair.best_of([*registered, *beside], thinned=True)
        return other if found.lead_over(other.registrations[0]) < 0.0 else best
    return best


def leads_surely(
    target: RegistrationCloud, source: RegistrationCloud, hypotheses: Sequence[Hypothesis], config: CalibrationConfig
) -> bool:
    """Return whether the first pose stays where it is and surely leads all others after a registration of few points.

    Args:
        hypotheses: as of `register_best`, of sides with views.
    """
    pair, hypotheses = _of_narrower_source(target, source, hypotheses, config, fit=True)
    registered = pair.register_thinned(pair.finalists(hypotheses))
    best, *others = likeliest_first([each.registrations[0] for each in registered])
    stays = not is_distinct(best.T_target_source, [hypotheses[0].T_target_source])
    limits = config.acceptance
    counts = not cannot_be_accepted(best.evidence, limits)
    return stays and counts and not any(may_compete(best, other, limits) for other in others)


def select_finalists(evidence: Sequence[float], config: AcceptanceConfig, most: int) -> list[int]:
    """Return the indices of the poses that may still win, the best first."""
    ranked = sorted(range(len(evidence)), key=lambda index: -evidence[index])[:most]
    if not ranked:
        return []
    needed = min_competing_evidence(evidence[ranked[0]], config)
    return [index for index in ranked if index == ranked[0] or evidence[index] > needed]


def _distance_m(hypothesis: Hypothesis) -> float:
    return float(np.linalg.norm(hypothesis.T_target_source.xyz_m))


def _start_of(found: Registration) -> Hypothesis:
    """Return a registered pose as a hypothesis of the same origin."""
    return Hypothesis(found.T_target_source, origin=found.origin, index=found.hypothesis, derivation=found.derivation)


def _register_first(
    target: RegistrationCloud, source: RegistrationCloud, first: Hypothesis, config: CalibrationConfig
) -> PairRegistration:
    """Register the first hypothesis only, as the paper does."""
    found = register(target.cloud, source.cloud, first.T_target_source, config.fine)
    if config.refine.enabled:
        sigmas = _bias_sigmas(target, source, config)
        found = _with_fit(found, pose_information(target.cloud, source.cloud, found.T_target_source, sigmas))
    return replace(found, hypothesis=first.index)


def _of_narrower_source(
    target: RegistrationCloud,
    source: RegistrationCloud,
    hypotheses: Sequence[Hypothesis],
    config: CalibrationConfig,
    *,
    fit: bool,
) -> tuple["_Pair", Sequence[Hypothesis]]:
    """Return both sides, the one with fewer points as the source, with the hypotheses as poses of that."""
    if len(source.cloud.points_m) > len(target.cloud.points_m):
        target, source = source, target
        hypotheses = [replace(each, T_target_source=each.T_target_source.inverse()) for each in hypotheses]
    return _Pair(target, source, config, fit), hypotheses


def _bias_sigmas(target: RegistrationCloud, source: RegistrationCloud, config: CalibrationConfig) -> FloatArray:
    return np.concatenate([prior_sigmas(side.cloud.name, config.refine) for side in (target, source)])


def _with_fit(found: PairRegistration, fit: PlaneFit) -> PairRegistration:
    return replace(found, T_target_source=fit.pose, information=fit.information, bias_information=fit.biases)


@dataclass(frozen=True, slots=True, eq=False)
class _Pair:
    """Both sides of a registration with the configuration."""

    target: RegistrationCloud
    source: RegistrationCloud
    config: CalibrationConfig
    fit: bool

    @property
    def clouds(self) -> tuple[GicpCloud, GicpCloud]:
        return self.target.cloud, self.source.cloud

    def finalists(self, hypotheses: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Select the distinct hypotheses that may win, and of groups what is like the best of them."""
        distinct: list[Hypothesis] = []
        for hypothesis in hypotheses:
            if is_distinct(hypothesis.T_target_source, [other.T_target_source for other in distinct]):
                distinct.append(hypothesis)
        if len(distinct) > 1:
            evidence = self._evidence(distinct)
            kept = select_finalists(evidence, self.config.acceptance, self.config.fine.max_finalists)
            distinct = [distinct[index] for index in kept]
        of_groups = self.fit and max(len(self.target.views), len(self.source.views)) > 1
        return distinct + self._alike(distinct[0]) if of_groups else distinct

    def _evidence(self, hypotheses: Sequence[Hypothesis]) -> list[float]:
        """Return the evidence of each hypothesis, beside the best where it is not known."""
        known = [each.evidence for each in hypotheses if each.evidence is not None]
        if len(known) == len(hypotheses):
            return known
        scores = [self._score(each.T_target_source) for each in hypotheses]
        distances_m = [_distance_m(each) for each in hypotheses]
        alone = [score.evidence(metres) for score, metres in zip(scores, distances_m, strict=True)]
        best = scores[alone.index(max(alone))]
        return [score.evidence_beside(best, metres) for score, metres in zip(scores, distances_m, strict=True)]

    def _score(self, pose: RigidTransform, tolerances: tuple[float, float] = ROUGH_TOLERANCES) -> VisibilityScore:
        return score_visibility(self.target.views, self.source.views, pose, *tolerances)

    def _alike(self, best: Hypothesis) -> list[Hypothesis]:
        """Return the poses of two groups that may compete with a known one: turned, or shifted where things repeat."""
        acceptance = self.config.acceptance
        known = self._score(best.T_target_source, COMPETING_TOLERANCES)
        needed = min_competing_evidence(known.evidence(_distance_m(best)), acceptance)
        views = self.target.views, self.source.views
        return [
            each
            for each in alike_hypotheses(*views, best, acceptance.max_baseline_m)
            if self._score(each.T_target_source, COMPETING_TOLERANCES).evidence_beside(known, _distance_m(each))
            > needed
        ]

    def register_thinned(
        self, hypotheses: Sequence[Hypothesis], beside: Sequence[PairRegistration] = ()
    ) -> list[PairRegistration]:
        """Register on fewer points; keep what is distinct from each other, and from others beside.

        Good hypotheses come from a short GICP and need few iterations. A registration that has not converged then
        continues only if it may win, the best first, until so many compete that no further one would decide.
        """
        clouds = self.target.thinned, self.source.thinned
        begun = [self._register(*clouds, hypothesis, self.target.finalist_gicp) for hypothesis in hypotheses]
        needed = min_competing_evidence(max(each.evidence for each in (*begun, *beside)), self.config.acceptance)
        registered = [*begun]
        for number in sorted(range(len(begun)), key=lambda number: -begun[number].evidence):
            start = begun[number]
            if start.converged is False and start.evidence > needed:
                further = replace(hypotheses[number], T_target_source=start.T_target_source)
                registered[number] = self._register(*clouds, further, self.config.fine)
            if self._is_surely_undecided([*registered, *beside]):
                break
        kept: list[PairRegistration] = []
        for found in registered:
            if is_distinct(found.T_target_source, [other.T_target_source for other in (*beside, *kept)]):
                kept.append(found)
        return kept

    def register(self, hypothesis: Hypothesis) -> PairRegistration:
        """Register on all points."""
        return self._register(*self.clouds, hypothesis, self.config.fine)

    def _register(
        self, target: GicpCloud, source: GicpCloud, hypothesis: Hypothesis, gicp: FineConfig
    ) -> PairRegistration:
        found = register(target, source, hypothesis.T_target_source, gicp)
        return self._scored(replace(found, hypothesis=hypothesis.index), hypothesis)

    def best_of(self, registered: Sequence[PairRegistration], *, thinned: bool) -> PairRegistration:
        """Return the likeliest one, on all points and with its stability; the others follow it.

        A pose with which others surely compete stays as it is: all points would not decide between them.

        Args:
            thinned: the registrations are of fewer points.
        """
        acceptance = self.config.acceptance
        found = within_baseline([each.registrations[0] for each in registered], acceptance.max_baseline_m)
        best, *others = likeliest_first(found)
        result = next(each for each in registered if each.registrations[0] is best)
        if thinned and self._is_surely_undecided(registered):
            return replace(result, registrations=(best, *others))
        if thinned and not cannot_be_accepted(best.evidence, acceptance):
            result = self._first_that_holds([best, *others])
            best = result.registrations[0]
            others = [each for each in found if is_distinct(each.T_target_source, [best.T_target_source])]
            others.sort(key=lambda each: -each.evidence)
        if best.evidence >= acceptance.min_evidence:
            by_gicp = result
            result = self._fitted(by_gicp, _start_of(best)) if self.fit else by_gicp
            best = result.registrations[0]
            if self._needs_stability(result, best, others):
                result = self._with_stability(by_gicp, result)
                others = [best, *others]
                best = result.registrations[0]
                others = [each for each in others if is_distinct(each.T_target_source, [best.T_target_source])]
        return replace(result, hypothesis=best.hypothesis, registrations=(best, *others))

    def _is_surely_undecided(self, roughly: Sequence[PairRegistration]) -> bool:
        """Return whether so many poses compete with the best of these that no further registration would decide."""
        acceptance = self.config.acceptance
        found = within_baseline([each.registrations[0] for each in roughly], acceptance.max_baseline_m)
        return len(surely_competing(likeliest_first(found), acceptance)) >= _SLIDE_POSES

    def _first_that_holds(self, ranked: Sequence[Registration]) -> PairRegistration:
        """Register poses on all points, up to the first that has enough evidence there too; else return the first."""
        acceptance = self.config.acceptance
        promising = [each for each in ranked if not cannot_be_accepted(each.evidence, acceptance)]
        found = (self.register(_start_of(each)) for each in promising)
        first = next(found)
        return next((each for each in chain([first], found) if each.evidence >= acceptance.min_evidence), first)

    def unmoved(self, start: Hypothesis) -> PairRegistration | None:
        """Fit a pose to planes without GICP; None if that moves it, or leaves a doubt."""
        pose = start.T_target_source
        names = self.target.cloud.name, self.source.cloud.name
        alone = PairRegistration(*names, pose, 0.0, np.inf, 0, None, None, self.config.fine.engine, start.index)
        if not is_well_constrained(self._scored(alone, start).registrations[0].visibility, self.config.acceptance):
            return None
        found = self._fitted(alone, start)
        best = found.registrations[0]
        moved = arc_between_m(pose, found.T_target_source) > _UNMOVED_M
        doubted = best.evidence < self.config.acceptance.min_evidence or self._needs_stability(found, best, [])
        return None if moved or doubted else found

    def _fitted(self, found: PairRegistration, start: Hypothesis) -> PairRegistration:
        """Fit the pose to planes, score it again, and add its information."""
        sigmas = _bias_sigmas(self.target, self.source, self.config)
        fitted = _with_fit(found, fit_planes(*self.clouds, found.T_target_source, sigmas))
        pose = fitted.T_target_source
        fitness, rmse_m, inliers = fitness_and_rmse(*self.clouds, pose, self.config.fine.fitness_distance_m)
        fitted = replace(fitted, fitness=fitness, rmse_m=rmse_m, inliers=inliers)
        if max(len(self.target.views), len(self.source.views)) > 1:
            fitted = replace(fitted, bias_information=None)  # a group has several LiDARs
        return self._scored(fitted, replace(start, T_target_source=pose))

    def _needs_stability(self, found: PairRegistration, best: Registration, others: Sequence[Registration]) -> bool:
        """Return whether the pose may slide: not well constrained, uncertain, or with a competing pose."""
        acceptance = self.config.acceptance
        sigma_m, sigma_rad = weakest_sigmas(found.information)
        uncertain = imprecision(sigma_m, sigma_rad, acceptance, _SIGMA_MARGIN) is not None
        loose = not is_well_constrained(best.visibility, acceptance)
        return loose or uncertain or bool(competing_poses([best, *others], acceptance))

    def _with_stability(self, by_gicp: PairRegistration, fitted: PairRegistration) -> PairRegistration:
        """Test the stability; a pose that ends at the same other pose from both sides has stopped short of that.

        Args:
            by_gicp: the end of GICP, to which a perturbed registration returns.
        """
        for last in (False, True):
            ends, stability = self._stability(by_gicp, fitted.information)
            further = None if last else self._farther(by_gicp, ends)
            if further is None:
                break
            by_gicp = further
            fitted = self._fitted(by_gicp, _start_of(by_gicp.registrations[0])) if self.fit else by_gicp
        best = by_gicp.registrations[0]
        off_m, direction = stability.perturbed_offset_m, best.visibility.weakest_direction
        fitted = widened_along(fitted, direction, off_m)
        sigma_m, sigma_rad = weakest_sigmas(fitted.information)
        stability = replace(stability, sigma_m=sigma_m, sigma_rad=sigma_rad)
        return replace(fitted, registrations=(replace(fitted.registrations[0], stability=stability),))

    def _stability(
        self, by_gicp: PairRegistration, information: FloatArray | None
    ) -> tuple[tuple[RigidTransform, RigidTransform], Stability]:
        """Perturb a pose, on fewer points first: if it ends farther away than it was pushed, they do not hold it."""
        fine, perturbation_m = self.config.fine, self.config.acceptance.perturbation_m
        pose, direction = by_gicp.T_target_source, by_gicp.registrations[0].visibility.weakest_direction
        thinned = (self.target.thinned, self.source.thinned)
        if thinned != self.clouds:
            ends = perturbed_ends(thinned, pose, direction, perturbation_m, fine)
            off_m = max(arc_between_m(pose, end) for end in ends)
            if off_m > perturbation_m:
                return ends, Stability(*weakest_sigmas(information), perturbation_m, off_m, off_m)
        ends = perturbed_ends(self.clouds, pose, direction, perturbation_m, fine)
        of_fewer = None if thinned == self.clouds else thinned
        return ends, check_stability(of_fewer, pose, information, ends, perturbation_m, fine)

    def _farther(
        self, by_gicp: PairRegistration, ends: tuple[RigidTransform, RigidTransform]
    ) -> PairRegistration | None:
        """Register where a pose ends from both sides, if that is elsewhere; None if it is not more likely there."""
        if arc_between_m(*ends) > _SAME_END_M or arc_between_m(by_gicp.T_target_source, ends[0]) <= _SAME_END_M:
            return None
        best = by_gicp.registrations[0]
        further = self.register(replace(_start_of(best), T_target_source=ends[0]))
        return further if further.evidence >= best.evidence else None

    def _scored(self, found: PairRegistration, hypothesis: Hypothesis) -> PairRegistration:
        scored = score_registration(found, hypothesis, self.target.views, self.source.views, *FINE_TOLERANCES)
        return replace(found, registrations=(scored,))
