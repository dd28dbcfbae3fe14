# SPDX-License-Identifier: Apache-2.0
"""Verdicts on registrations: the log-odds that a pose is true, alone and against its competitors."""

from collections.abc import Sequence
from functools import reduce
from math import log, log1p

import numpy as np

from multilica.acceptance.placement import imprecision
from multilica.config import AcceptanceConfig, MergeConfig
from multilica.geometry import FloatArray, largest_index
from multilica.registration.poses import is_distinct
from multilica.results import PairRegistration, Reason, Registration, Stability, Verdict, VisibilityScore
from multilica.results.hypotheses import REPEATED
from multilica.results.visibility_score import DISTINCTIVE_WEIGHT, HIDDEN_WEIGHT

# No match of features led to a turned, repeated or slid pose: it is one of six or so, any of which may fit by chance.
_OF_DERIVED = log(6.0)
# A competing pose with the same attitude, this much of whose offset lies along the slide, is the end of a slide.
_SLID_RAD = float(np.deg2rad(5.0))
_SLID_SHARE = 0.9
# Points that pin a pose along its weakest direction: one point pins it to about 10 mm, so fewer than a tenth of one to
# 30 mm at best. One of 966 accepted pairs had fewer, and 3 of 114 uncertain ones.
_LEAST_INFORMATION = 0.1
# Posts and niches constrain a pose along a tunnel. Most pairs in streets, yards and halls have a share of 0.2 to 1.
_LONG_PLACE = 0.1
# The fine registration changes the evidence of a rough one by less.
_ROUGH_MARGIN = 2.0
# The fine registration does not bring poses together that are farther apart, in metres or radians.
_ELSEWHERE = (1.0, float(np.deg2rad(10.0)))
# Any distance up to this is usual between two LiDARs of one vehicle.
_USUAL_BASELINE_M = 6.0
# Figures of usual true poses, with which those of a refused pose are compared to name its weakness.
_USUAL_DISTINCTIVE = 400.0
_USUAL_SHARE = 0.85
_USUAL_DISTANCE_M = 1.5


def accept(registrations: Sequence[Registration], config: AcceptanceConfig, views: int = 1) -> Verdict:
    """Decide on the first and best of a pair's distinct registrations.

    Reject: too little speaks for the pose, or too much against it. Undecided: a competing pose is nearly as likely, or
    the pose slides. Uncertain: neither, but its standard deviation is above the limit.

    Args:
        views: LiDARs of the larger of two groups. Those side by side see the same points, which count once for each.
    """
    best = registrations[0]
    distance_m = float(np.linalg.norm(best.T_target_source.xyz_m))
    least = config.min_evidence + (_OF_DERIVED if best.is_derived else 0.0)
    if best.evidence < least or distance_m > config.max_baseline_m:
        return Verdict("reject", _weaknesses(best, distance_m, least, config))
    doubts = (_slide(best, config, views * _LEAST_INFORMATION), _competition(registrations, config))
    # Both may describe the same slide.
    reasons = {reason.code: reason for reason in reversed(doubts) if reason is not None}
    if reasons:
        return Verdict("undecided", tuple(reasons.values())[::-1])
    stability = best.stability
    doubt = None if stability is None else imprecision(stability.sigma_m, stability.sigma_rad, config)
    return Verdict("accept") if doubt is None else Verdict("uncertain", (doubt,))


def accept_by_fitness(registration: PairRegistration, config: MergeConfig) -> Verdict:
    """Accept a fitness above the threshold, as the paper does."""
    if registration.fitness > config.fitness_threshold:
        return Verdict("accept")
    text = f"fitness {registration.fitness:.3f} is not above {config.fitness_threshold:g}"
    return Verdict("reject", (Reason("low_fitness", registration.fitness, config.fitness_threshold, text),))


def is_well_constrained(score: VisibilityScore, config: AcceptanceConfig) -> bool:
    """Return whether enough points constrain every direction, so that no pose beside it needs a test."""
    return score.min_information_eigenvalue >= config.min_well_constrained_eigenvalue


def is_in_long_place(score: VisibilityScore) -> bool:
    """Return whether a pose is that of a road between walls, or of a tunnel: what constrains it there often repeats."""
    return score.slide_share < _LONG_PLACE


def cannot_be_accepted(evidence: float, config: AcceptanceConfig) -> bool:
    """Return whether a roughly registered pose has too little evidence to be accepted after the fine registration."""
    return evidence < config.min_evidence - _ROUGH_MARGIN


def may_be_accepted(roughly: Sequence[Registration], config: AcceptanceConfig) -> bool:
    """Return whether the first of a pair's roughly registered poses may be accepted after the fine registration.

    Poses near each other may still end at one.
    """
    if not roughly or cannot_be_accepted(roughly[0].evidence, config):
        return False
    least = config.min_log_odds_margin - 2.0 * _ROUGH_MARGIN
    return all(roughly[0].lead_over(other) >= least for other in _elsewhere(roughly))


def is_surely_ambiguous(roughly: Sequence[Registration], config: AcceptanceConfig) -> bool:
    """Return whether another roughly registered pose will compete with the first after the fine registration too."""
    best, *others = roughly
    return any(best.lead_over(other) < config.min_log_odds_margin - _ROUGH_MARGIN for other in others)


def surely_competing(roughly: Sequence[Registration], config: AcceptanceConfig) -> list[Registration]:
    """Select the roughly registered poses elsewhere that will compete with the first after the fine registration."""
    return [other for other in _elsewhere(roughly) if is_surely_ambiguous([roughly[0], other], config)]


def likeliest_first(found: Sequence[Registration]) -> list[Registration]:
    """Order the poses of a pair by evidence, but put the one that leads all others first, if there is one."""
    ranked = sorted(found, key=lambda each: -each.evidence)
    if not ranked:
        return ranked
    best = reduce(lambda known, other: other if known.lead_over(other) < 0.0 else known, ranked)
    return [best, *(each for each in ranked if each is not best)]


def _elsewhere(roughly: Sequence[Registration]) -> list[Registration]:
    """Select the poses that the fine registration does not bring together with the first."""
    best, *others = roughly
    return [other for other in others if is_distinct(other.T_target_source, [best.T_target_source], *_ELSEWHERE)]


def may_compete(best: Registration, other: Registration, config: AcceptanceConfig) -> bool:
    """Return whether another roughly registered pose may compete with the first after the fine registration."""
    return best.lead_over(other) < config.min_log_odds_margin + _ROUGH_MARGIN or _repeats(best, other, config)


def min_competing_evidence(best_evidence: float, config: AcceptanceConfig) -> float:
    """Return the evidence below which a roughly registered pose will not compete with the best."""
    return (
        best_evidence
        if cannot_be_accepted(best_evidence, config)
        else best_evidence - config.min_log_odds_margin - _ROUGH_MARGIN
    )


def competing_poses(registrations: Sequence[Registration], config: AcceptanceConfig) -> list[Registration]:
    """Select the poses beside the best that are nearly as likely, or that show a repetition, the likeliest first.

    A lead may rest on the few points that face the way between two poses. Then more evidence for the other one counts.
    The best pose of all 411 right pairs of 186 snapshots had the most evidence.
    """
    best, *others = registrations
    margin = config.min_log_odds_margin
    near = [
        other
        for other in others
        if best.lead_over(other) < margin or other.evidence > best.evidence or _repeats(best, other, config)
    ]
    return sorted(near, key=best.lead_over)


def _repeats(best: Registration, other: Registration, config: AcceptanceConfig) -> bool:
    """Return whether two poses of the same attitude are both possible, so that what the LiDARs see repeats.

    Evidence counts surfaces that agree. If these repeat, the pose with the larger common view has more of them, and one
    that puts both LiDARs at one place has most. Only points in empty space tell the two apart then. Between stops,
    other links tell.
    """
    pose = other.T_target_source
    metres, radians = best.T_target_source.distance_to(pose)
    return (
        metres > 0.0
        and radians < _SLID_RAD
        and other.evidence >= config.min_evidence
        and float(np.linalg.norm(pose.xyz_m)) <= _USUAL_BASELINE_M
        and other.visibility.contradiction_against(best.visibility) <= 0.0
        and not best.visibility.between_stops
    )


def slides(found: Stability, config: AcceptanceConfig) -> bool:
    """Return whether a perturbed pose does not return, or ends elsewhere with fewer points."""
    return max(found.perturbed_offset_m, found.thinned_offset_m) > config.max_perturbed_offset_m


def _weaknesses(
    best: Registration, distance_m: float, min_evidence: float, config: AcceptanceConfig
) -> tuple[Reason, ...]:
    """Return what costs a refused pose most, against the figures of usual true poses, the worst first."""
    score = best.visibility
    losses = {
        "too_little_evidence": DISTINCTIVE_WEIGHT * (log1p(_USUAL_DISTINCTIVE) - log1p(max(0.0, score.distinctive))),
        "empty_space_violated": score.contradiction,
        "structure_unexplained": HIDDEN_WEIGHT * (log(_USUAL_SHARE) - log(score.shared_share)),
        "too_far_apart": score.against_distance(distance_m) - score.against_distance(_USUAL_DISTANCE_M),
    }
    worst = max(losses.values())
    hidden, seen = score.structure_occluded, score.structure_agree + score.structure_occluded
    texts = {
        "too_little_evidence": f"only {score.distinctive:.0f} points lie on walls and objects that both measured",
        "empty_space_violated": f"{score.violation_share:.1%} of the points lie in space that the other sensor's beams "
        "passed through",
        "structure_unexplained": f"{hidden} of {seen} points on walls and objects in view of both would be hidden",
        "too_far_apart": f"the LiDARs would be {distance_m:.1f} m apart",
    }
    odds = f"(evidence {best.evidence:z.1f}, limit {min_evidence:.2g})"
    if distance_m > config.max_baseline_m:
        limit = f"limit {config.max_baseline_m:g} m (acceptance.max_baseline_m)"
        return (Reason("too_far_apart", distance_m, config.max_baseline_m, f"{texts['too_far_apart']}, {limit}"),)
    return tuple(
        Reason(code, best.evidence, min_evidence, f"{texts[code]} {odds}")
        for code in sorted(losses, key=lambda code: -losses[code])
        if losses[code] >= 0.5 * worst
    )


def _competition(registrations: Sequence[Registration], config: AcceptanceConfig) -> Reason | None:
    """Describe the likeliest competing pose: a repetition, the end of a slide of the best, or another place."""
    best = registrations[0]
    other = next(iter(competing_poses(registrations, config)), None)
    if other is None:
        return None
    metres, radians = best.T_target_source.distance_to(other.T_target_source)
    shift_m = other.T_target_source.xyz_m - best.T_target_source.xyz_m
    along_m = float(np.abs(shift_m @ best.visibility.slide_direction))
    lead = best.lead_over(other)
    if lead >= config.min_log_odds_margin and other.evidence > best.evidence:
        odds = f"evidence {other.evidence:z.1f} against {best.evidence:z.1f}"
        text = f"a pose {metres:.2f} m away has more evidence ({odds}); only points that face that way prefer this one"
        return Reason("ambiguous", best.evidence - other.evidence, 0.0, text, other)
    if lead >= config.min_log_odds_margin:
        odds = f"evidence {other.evidence:z.1f}, limit {config.min_evidence:.2g}"
        text = f"the scene repeats: a pose {metres:.2f} m away is possible too ({odds}), and no beam speaks against it"
        return Reason("held_by_repetition", other.evidence, config.min_evidence, text, other)
    evidence = f"evidence {other.evidence_beside(best):z.1f} against {best.evidence:z.1f}"
    fits = f"fits as well ({evidence}, required margin {config.min_log_odds_margin:g})"
    if radians < _SLID_RAD and any(each.derivation.startswith(REPEATED) for each in (best, other)):
        text = f"the scene repeats: a pose {metres:.2f} m away {fits}"
        return Reason("held_by_repetition", lead, config.min_log_odds_margin, text, other)
    if radians < _SLID_RAD and along_m > _SLID_SHARE * metres:
        direction = _axis_text(np.concatenate([np.zeros(3), shift_m]), best.T_target_source.target)
        text = f"the scene does not constrain the pose {direction}: a pose {metres:.2f} m away {fits}"
        return Reason("not_observable", lead, config.min_log_odds_margin, text)
    text = f"a pose {metres:.2f} m and {np.rad2deg(radians):.0f} deg away {fits}"
    return Reason("ambiguous", lead, config.min_log_odds_margin, text, other)


def _slide(best: Registration, config: AcceptanceConfig, least_information: float) -> Reason | None:
    found = best.stability
    if found is None:
        return None
    direction = _axis_text(best.visibility.weakest_direction, best.T_target_source.target)
    if not slides(found, config):
        return _unfounded(best, direction, least_information)
    text = f"with fewer points it ends {found.thinned_offset_m:.2f} m away"
    if found.perturbed_offset_m > config.max_perturbed_offset_m:
        text = f"perturbed by {found.perturbation_m:g} m it ends {found.perturbed_offset_m:.2f} m away"
    off_m = max(found.perturbed_offset_m, found.thinned_offset_m)
    text = f"the scene does not constrain the pose {direction} ({text}, limit {config.max_perturbed_offset_m:g} m)"
    return Reason("not_observable", off_m, config.max_perturbed_offset_m, text)


def _unfounded(best: Registration, direction: str, least: float) -> Reason | None:
    """Return a reason if hardly a point constrains the pose in a direction: it fits by chance."""
    information = best.visibility.min_information_eigenvalue
    if information >= least:
        return None
    text = f"the scene does not constrain the pose {direction}: only {information:.2f} points hold it there"
    return Reason("not_observable", information, least, f"{text} (limit {least:g})")


def _axis_text(motion: FloatArray, target: str) -> str:
    """Name the main axis of a small motion: order rotation, translation along the target's axes."""
    axis = largest_index(motion)
    return f"{'about' if axis < 3 else 'along'} {'xyz'[axis % 3]} of {target}"
