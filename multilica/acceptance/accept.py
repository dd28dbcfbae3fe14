# SPDX-License-Identifier: Apache-2.0
"""Verdicts on registrations."""

from collections.abc import Iterator, Sequence

import numpy as np

from multilica.config import AcceptanceConfig, MergeConfig, StabilityConfig
from multilica.geometry import FloatArray, largest_index
from multilica.results import PairRegistration, Reason, Registration, Stability, Verdict, VisibilityScore

__all__ = ["accept", "accept_by_fitness", "competing_poses", "hopeless_below", "is_firm", "max_violation_share"]

# A competing pose with the same attitude, this much of whose offset lies along the slide, is the end of a slide.
_SLID_RAD = float(np.deg2rad(5.0))
_SLID_SHARE = 0.9
# Few enough to be the noise of single returns, whatever share they make of a small view.
_STRAY_POINTS = 2
# A fine registration may raise the evidence of a rough one by about a fifth.
_ROUGH_SHARE = 0.8
# A pose that no vehicle could have competes only if it has more evidence than the best.
_MAX_IMPLAUSIBLE_SHARE = 1.0


def accept(registrations: Sequence[Registration], config: AcceptanceConfig, stability: StabilityConfig) -> Verdict:
    """Check the first and best of a pair's distinct registrations against the limits and against the others.

    Reject: too little surface in common, or points, or a LiDAR, in proven-empty space. Undecided: a competing pose
    explains nearly as much, the pose is not constrained, much of the structure in view is not explained, or the LiDARs
    would be farther apart than a vehicle is long.
    """
    best = registrations[0]
    rejections = list(_rejections(best.visibility, config))
    doubts = [
        _ambiguity(registrations, config),
        _observability(best, config, stability),
        _explanation(best.visibility, config),
        _distance(best, config),
    ]
    found = [*rejections, *(doubt for doubt in doubts if doubt is not None)]
    # Two doubts may describe the same slide: the first of each code stays.
    reasons = tuple({reason.code: reason for reason in reversed(found)}.values())[::-1]
    if rejections:
        return Verdict("reject", reasons)
    return Verdict("undecided" if reasons else "accept", reasons)


def accept_by_fitness(registration: PairRegistration, config: MergeConfig) -> Verdict:
    """Accept a fitness at or above the threshold, as the paper does."""
    if registration.fitness >= config.fitness_threshold:
        return Verdict("accept")
    text = f"fitness {registration.fitness:.3f} is below {config.fitness_threshold:g}"
    return Verdict("reject", (Reason("low_fitness", registration.fitness, config.fitness_threshold, text),))


def is_firm(score: VisibilityScore, config: AcceptanceConfig) -> bool:
    """Tell whether so many points constrain every direction that parallax and clutter need no further explanation."""
    return score.min_information_eigenvalue >= config.firm_eigenvalue


def max_violation_share(score: VisibilityScore, config: AcceptanceConfig) -> float:
    """Return the share of points in proven-empty space that can be chance; less for a pose that is not firm."""
    share = config.max_violation_share_firm if is_firm(score, config) else config.max_violation_share
    return max(share, _STRAY_POINTS / max(1, score.agree + score.violate))


def hopeless_below(best_evidence: float, config: AcceptanceConfig) -> float:
    """Return the evidence below which a roughly registered pose will not compete with the best."""
    small_share = _ROUGH_SHARE * config.max_standing_share * best_evidence
    return min(best_evidence - config.hopeless_evidence, small_share)


def competing_poses(registrations: Sequence[Registration], config: AcceptanceConfig) -> list[Registration]:
    """Select the poses beside the best that would be accepted by themselves."""
    if len(registrations) < 2 or registrations[0].evidence <= 0:
        return []
    best, *others = registrations
    return [
        other
        for other in others
        if other.evidence > config.max_standing_share * best.evidence and _stands_alone(other, best, config)
    ]


def _rejections(score: VisibilityScore, config: AcceptanceConfig) -> Iterator[Reason]:
    if score.agree < config.min_agreeing_points:
        text = f"only {score.agree} points lie on surfaces that both measured (limit {config.min_agreeing_points})"
        yield Reason("too_little_overlap", float(score.agree), float(config.min_agreeing_points), text)
    limit = max_violation_share(score, config)
    if score.violation_share > limit:
        text = f"{score.violation_share:.1%} of the points lie in space that the other sensor's beams passed through"
        yield Reason("empty_space_violated", score.violation_share, limit, f"{text} (limit {limit:.1%})")
    if score.seen_through_m > 0.0:
        text = (
            f"beams of one LiDAR pass through the place of the other, {score.seen_through_m:.1f} m away, and all "
            "around it, where nothing could carry a LiDAR"
        )
        yield Reason("place_proven_empty", score.seen_through_m, 0.0, text)
    if score.evidence < config.min_evidence:
        text = f"the evidence is {max(0.0, score.evidence):.0f} points off the main plane, less violations"
        yield Reason(
            "too_little_evidence", score.evidence, config.min_evidence, f"{text} (limit {config.min_evidence:g})"
        )


def _ambiguity(registrations: Sequence[Registration], config: AcceptanceConfig) -> Reason | None:
    best, *others = registrations
    if best.evidence <= 0:
        return None
    standing = competing_poses(registrations, config)
    for other in others:
        limit = config.max_standing_share if other in standing else config.max_competing_share
        limit = _MAX_IMPLAUSIBLE_SHARE if _is_implausible(other, config) else limit
        share = max(0.0, other.evidence / best.evidence)
        if share > limit:
            return _competes(best, other, share, limit)
    return None


def _competes(best: Registration, other: Registration, share: float, limit: float) -> Reason:
    """Describe a competing pose: as the end of a slide of the best, or as another place."""
    metres, radians = best.T_target_source.distance_to(other.T_target_source)
    shift_m = other.T_target_source.xyz_m - best.T_target_source.xyz_m
    along_m = float(np.abs(shift_m @ best.visibility.slide_direction))
    fits = f"fits as well ({share:.0%} of the evidence, limit {limit:.0%})"
    if radians < _SLID_RAD and along_m > _SLID_SHARE * metres:
        direction = _axis_text(np.concatenate([np.zeros(3), shift_m]), best.T_target_source.target)
        text = f"the scene does not constrain the pose {direction}: a pose {metres:.2f} m away {fits}"
        return Reason("not_observable", share, limit, text)
    text = f"a pose {metres:.2f} m and {np.rad2deg(radians):.0f} deg away {fits}"
    return Reason("ambiguous", share, limit, text, other)


def _stands_alone(other: Registration, best: Registration, config: AcceptanceConfig) -> bool:
    """Tell whether a pose would be accepted if the best were not known: it may have less of the scene in view."""
    score = other.visibility
    return (
        score.agree >= config.min_agreeing_points
        and score.violation_share <= max_violation_share(score, config)
        and score.explained_share >= config.min_standing_explained * best.visibility.explained_share
        and score.min_information_eigenvalue >= config.min_standing_eigenvalue
        and other.weakest_curvature >= config.min_curvature
    )


def _is_implausible(other: Registration, config: AcceptanceConfig) -> bool:
    """Tell whether the LiDARs would be too far apart, and beams, structure or a flat fit contradict the pose as well.

    In an open field few things stand, so chance agreements are anywhere.
    """
    score = other.visibility
    violated = score.violation_share > max_violation_share(score, config)
    contradicted = violated or _explanation(score, config) is not None
    return _distance(other, config) is not None and (contradicted or other.weakest_curvature < config.min_curvature)


def _observability(best: Registration, config: AcceptanceConfig, stability: StabilityConfig) -> Reason | None:
    """Return the first flaw: a flat fit, a pose that does not return, depends on single points, or is uncertain."""
    curvature = best.weakest_curvature
    flaw = _instability(best.stability, config, stability)
    if curvature < config.min_curvature:
        flaw = curvature, config.min_curvature, f"curvature {curvature:z.2f}, limit {config.min_curvature:g}"
    if flaw is None:
        return None
    value, limit, text = flaw
    direction = _axis_text(best.visibility.weakest_direction, best.T_target_source.target)
    return Reason("not_observable", value, limit, f"the scene does not constrain the pose {direction} ({text})")


def _instability(
    found: Stability | None, config: AcceptanceConfig, limits: StabilityConfig
) -> tuple[float, float, str] | None:
    """Return the figure that shows an unconstrained pose, its limit, and both as text."""
    if found is None:
        return None
    if found.pushed_off_m > limits.max_pushed_off_m:
        text = f"pushed by {found.push_m:g} m it ends {found.pushed_off_m:.3f} m away"
        return found.pushed_off_m, limits.max_pushed_off_m, f"{text}, limit {limits.max_pushed_off_m:g} m"
    if found.thinned_off_m > limits.max_thinned_off_m:
        text = f"with fewer points it ends {found.thinned_off_m:.2f} m away"
        return found.thinned_off_m, limits.max_thinned_off_m, f"{text}, limit {limits.max_thinned_off_m:g} m"
    if found.sigma_m is not None and found.sigma_m > config.max_sigma_m:
        text = f"sigma {1000.0 * found.sigma_m:.0f} mm, limit {1000.0 * config.max_sigma_m:g} mm"
        return found.sigma_m, config.max_sigma_m, text
    sigma_deg = 0.0 if found.sigma_rad is None else float(np.rad2deg(found.sigma_rad))
    if sigma_deg > config.max_sigma_deg:
        return sigma_deg, config.max_sigma_deg, f"sigma {sigma_deg:.2f} deg, limit {config.max_sigma_deg:g} deg"
    return None


def _explanation(best: VisibilityScore, config: AcceptanceConfig) -> Reason | None:
    limit = config.min_explained_share_firm if is_firm(best, config) else config.min_explained_share
    if best.explained_share >= limit:
        return None
    text = (
        f"of the walls and objects in view of both, only {best.explained_share:.0%} is explained (limit {limit:.0%}): "
        f"{best.structure_agree} points lie on surfaces that the other measured, {best.structure_occluded} are hidden, "
        f"{best.structure_violate} lie in empty space"
    )
    return Reason("structure_unexplained", best.explained_share, limit, text)


def _distance(best: Registration, config: AcceptanceConfig) -> Reason | None:
    firm = is_firm(best.visibility, config)
    key = "max_baseline_m" if firm else "max_baseline_loose_m"
    limit_m = config.max_baseline_m if firm else config.max_baseline_loose_m
    distance_m = float(np.linalg.norm(best.T_target_source.xyz_m))
    if distance_m <= limit_m:
        return None
    text = (
        f"the LiDARs would be {distance_m:.1f} m apart; the limit is {limit_m:g} m (acceptance.{key}) for a pose "
        f"with smallest information eigenvalue {best.visibility.min_information_eigenvalue:z.1f}"
    )
    return Reason("too_far_apart", distance_m, limit_m, text)


def _axis_text(motion: FloatArray, target: str) -> str:
    """Name the main axis of a small motion: order rotation, translation along the target's axes."""
    axis = largest_index(motion)
    return f"{'about' if axis < 3 else 'along'} {'xyz'[axis % 3]} of {target}"
