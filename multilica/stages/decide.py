# SPDX-License-Identifier: Apache-2.0
"""Accept, reject or leave undecided what a registration claims."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from multilica.config import MergeConfig, VerifyConfig
from multilica.geometry import FloatArray
from multilica.results import Assessment, Hold, PairRegistration, Reason, Verdict
from multilica.testimony import Testimony

__all__ = ["decide", "decide_by_fitness", "hopeless_below", "max_violation_share", "standing_rivals"]

_SLID_RAD = float(np.deg2rad(5.0))
_SLID_SHARE = 0.9
_STRAY_POINTS = 2
_ROUGHLY = 0.8
# A far-fetched rival counts only with more evidence than the best.
_FAR_FETCHED_SHARE = 1.0


def decide(finalists: Sequence[Assessment], config: VerifyConfig) -> Verdict:
    """Judge the best of the distinct answers that were registered finely, the one with the most evidence first.

    Reject: too little surface in common, or points, or a LiDAR, in space that beams proved empty. Undecided: another
    distinct answer explains nearly as much, the pose can slide without the fit getting worse, much of the structure in
    view is left unexplained, or the LiDARs would be farther apart than the vehicle is long.
    """
    best = finalists[0].testimony
    violation_limit = max_violation_share(best, config)
    against = [
        _check(
            "too_little_overlap",
            best.agree,
            config.min_agree,
            f"only {best.agree} points lie on surfaces that both measured; expected {config.min_agree}",
            failed=best.agree < config.min_agree,
        ),
        _check(
            "empty_space_violated",
            best.violation_share,
            violation_limit,
            f"{best.violation_share:.1%} of the points stand in space that the other sensor's beams passed through; "
            f"at most {violation_limit:.1%} can be chance",
            failed=best.violation_share > violation_limit,
        ),
        _check(
            "place_proven_empty",
            best.seen_through_m,
            0.0,
            f"the beams of one pass through the place of the other, {best.seen_through_m:.1f} m away, and through all "
            "around it, where nothing could carry a LiDAR",
            failed=best.seen_through_m > 0.0,
        ),
        _check(
            "too_little_evidence",
            best.evidence,
            config.min_evidence,
            f"the pose rests on {max(0.0, best.evidence):.0f} distinctive points, those that contradict it taken off; "
            f"expected {config.min_evidence:g}",
            failed=best.evidence < config.min_evidence,
        ),
    ]
    doubts = [
        _ambiguity(finalists, config),
        _observability(finalists[0], config),
        _explanation(finalists[0].testimony, config),
        _distance(finalists[0], config),
    ]
    found = [reason for reason in (*against, *doubts) if reason is not None]
    # Two doubts may tell of the same sliding.
    reasons = tuple({reason.code: reason for reason in reversed(found)}.values())[::-1]
    if any(reason in reasons for reason in against):
        return Verdict("reject", reasons)
    return Verdict("undecided" if reasons else "accept", reasons)


def decide_by_fitness(registration: PairRegistration, config: MergeConfig) -> Verdict:
    """The paper's gate: fitness at or above the threshold."""
    if registration.fitness >= config.fitness_threshold:
        return Verdict("accept")
    text = f"fitness {registration.fitness:.3f} is below {config.fitness_threshold:g}"
    return Verdict("reject", (Reason("low_fitness", registration.fitness, config.fitness_threshold, text),))


def max_violation_share(testimony: Testimony, config: VerifyConfig) -> float:
    """The share of points in proven-empty space that can be chance; a loosely held pose finds fits by chance, too."""
    share = config.max_violation_share_firm if _is_firm(testimony, config) else config.max_violation_share
    return max(share, _STRAY_POINTS / max(1, testimony.agree + testimony.violate))


def hopeless_below(best_evidence: float, config: VerifyConfig) -> float:
    """The evidence below which a roughly registered answer will not rival the best: far behind, and a small share.

    A finer registration may add to what is just below the share that counts.
    """
    return min(best_evidence - config.hopeless_evidence, _ROUGHLY * config.max_equal * best_evidence)


def standing_rivals(finalists: Sequence[Assessment], config: VerifyConfig) -> list[Assessment]:
    """The distinct poses beside the best that would be believed if the best were not known."""
    if len(finalists) < 2 or finalists[0].evidence <= 0:
        return []
    best, *rivals = finalists
    return [
        rival
        for rival in rivals
        if rival.evidence > config.max_equal * best.evidence and _stands_by_itself(rival, best, config)
    ]


def _is_firm(testimony: Testimony, config: VerifyConfig) -> bool:
    return testimony.held_by >= config.firmly_held_by


def _ambiguity(finalists: Sequence[Assessment], config: VerifyConfig) -> Reason | None:
    best, *rivals = finalists
    if best.evidence <= 0:
        return None
    standing = standing_rivals(finalists, config)
    for rival in rivals:
        limit = config.max_equal if rival in standing else config.max_runner_up
        limit = _FAR_FETCHED_SHARE if _is_far_fetched(rival, config) else limit
        ratio = max(0.0, rival.evidence / best.evidence)
        if ratio > limit:
            return _undecided(best, rival, ratio, limit)
    return None


def _undecided(best: Assessment, rival: Assessment, ratio: float, limit: float) -> Reason:
    """That the rival explains too much: as far as the scene lets the best pose slide, or elsewhere."""
    metres, radians = best.T_target_source.distance_to(rival.T_target_source)
    shift_m = rival.T_target_source.xyz_m - best.T_target_source.xyz_m
    along = float(np.abs(shift_m @ best.testimony.slide_direction))
    share = f"{ratio:.0%} of the evidence; at most {limit:.0%} leaves no doubt"
    if radians < _SLID_RAD and along > _SLID_SHARE * metres:
        where = _in_words(np.concatenate([np.zeros(3), shift_m]), best.T_target_source.target)
        return Reason("not_observable", ratio, limit, f"the pose can slide {where}: {metres:.2f} m away it has {share}")
    text = f"another pose, {metres:.2f} m and {np.rad2deg(radians):.0f} deg away, has {share}"
    return Reason("ambiguous", ratio, limit, text)


def _stands_by_itself(rival: Assessment, best: Assessment, config: VerifyConfig) -> bool:
    """Whether the rival would be believed if the best were not known: it may just have less of the scene in view."""
    return (
        rival.testimony.agree >= config.min_agree
        and rival.testimony.violation_share <= max_violation_share(rival.testimony, config)
        and rival.testimony.explained_share >= config.alike * best.testimony.explained_share
        and rival.testimony.held_by >= config.rival_held_by
        and rival.weakest_curvature >= config.min_curvature
    )


def _is_far_fetched(rival: Assessment, config: VerifyConfig) -> bool:
    """Whether the LiDARs would be too far apart, and beams, structure or a flat fit speak against it, too.

    In an open field few things stand, so that agreements by chance are anywhere.
    """
    said = rival.testimony
    contradicted = said.violation_share > max_violation_share(said, config) or _explanation(said, config) is not None
    return _distance(rival, config) is not None and (contradicted or rival.weakest_curvature < config.min_curvature)


def _observability(best: Assessment, config: VerifyConfig) -> Reason | None:
    """The first that fails: the fit is flat, the pose does not come back, depends on single points, or is not sure."""
    curvature = best.weakest_curvature
    flaw = _flaw_of(best.hold, config)
    if curvature < config.min_curvature:
        flaw = curvature, config.min_curvature, f"curvature {curvature:.2f}; expected {config.min_curvature:g}"
    if flaw is None:
        return None
    value, limit, text = flaw
    where = _in_words(best.testimony.weakest_direction, best.T_target_source.target)
    return Reason("not_observable", value, limit, f"the pose can slide {where}: {text}")


def _flaw_of(hold: Hold | None, config: VerifyConfig) -> tuple[float, float, str] | None:
    """What shows that the points do not hold the pose: the figure, its limit, and both in words."""
    if hold is None:
        return None
    if hold.pushed_off_m > config.max_pushed_off_m:
        text = f"pushed by {hold.push_m:g} m, the registration ends {hold.pushed_off_m:.3f} m away"
        return hold.pushed_off_m, config.max_pushed_off_m, f"{text}; expected {config.max_pushed_off_m:g} m"
    if hold.thinned_off_m > config.max_thinned_off_m:
        text = f"with fewer points, the registration ends {hold.thinned_off_m:.2f} m away"
        return hold.thinned_off_m, config.max_thinned_off_m, f"{text}; expected {config.max_thinned_off_m:g} m"
    if hold.sigma_m is not None and hold.sigma_m > config.max_sigma_m:
        text = f"its standard deviation is {hold.sigma_m:.3f} m; expected {config.max_sigma_m:g} m"
        return hold.sigma_m, config.max_sigma_m, text
    sigma_deg = 0.0 if hold.sigma_rad is None else float(np.rad2deg(hold.sigma_rad))
    if sigma_deg > config.max_sigma_deg:
        text = f"its standard deviation is {sigma_deg:.2f} deg; expected {config.max_sigma_deg:g} deg"
        return sigma_deg, config.max_sigma_deg, text
    return None


def _explanation(best: Testimony, config: VerifyConfig) -> Reason | None:
    limit = config.min_explained_firm if _is_firm(best, config) else config.min_explained
    return _check(
        "structure_unexplained",
        best.explained_share,
        limit,
        f"of the walls and objects in view of both, {best.structure_agree} points lie on surfaces that the other "
        f"measured, {best.structure_occluded} are hidden and {best.structure_violate} stand in empty space: "
        f"{best.explained_share:.0%} are explained; expected {limit:.0%}",
        failed=best.explained_share < limit,
    )


def _distance(best: Assessment, config: VerifyConfig) -> Reason | None:
    firm = _is_firm(best.testimony, config)
    name, limit_m = ("rival_reach_m", config.rival_reach_m) if firm else ("loose_reach_m", config.loose_reach_m)
    distance_m = float(np.linalg.norm(best.T_target_source.xyz_m))
    return _check(
        "too_far_apart",
        distance_m,
        limit_m,
        f"the LiDARs would be {distance_m:.1f} m apart; a pose that {best.testimony.held_by:.1f} points hold is "
        f"believed up to {limit_m:g} m (verify.{name})",
        failed=distance_m > limit_m,
    )


def _in_words(direction: FloatArray, target: str) -> str:
    """The main part of a small motion: order rotation, translation along the target's axes."""
    axis = int(np.argmax(np.abs(direction)))
    return f"{'around' if axis < 3 else 'along'} {'xyz'[axis % 3]} of {target}"


def _check(code: str, value: float, limit: float, text: str, *, failed: bool) -> Reason | None:
    return Reason(code, float(value), float(limit), text) if failed else None
