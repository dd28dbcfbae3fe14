# SPDX-License-Identifier: Apache-2.0
"""The one place that decides whether a LiDAR is placed, uncertain or not placed, and for which reason."""

from collections.abc import Collection, Mapping, Sequence
from itertools import chain, combinations
from typing import Any

import numpy as np
from scipy.special import chdtrc

from multilica.config import STAGES, AcceptanceConfig, Stage
from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.poses import is_distinct
from multilica.results import (
    CalibrationResult,
    ContestedPlace,
    LidarPlacement,
    MergeDecision,
    PairKey,
    PairRegistration,
    PlacementStatus,
    PoseConflict,
    Reason,
    Registration,
)
from multilica.results.placements import LEAST_PROBABILITY
from multilica.results.registrations import weakest_deviations
from multilica.results.values import BY_CONTRADICTING, COVERED, OPEN_POSE
from multilica.visibility.sensor_view import ScorePose

TOO_FEW_SURFACES = "it shares too few surfaces with"
# Movable objects hold a pose if its standard deviation grows by this factor without them.
_HELD_GROWTH = 1.5
# The length of a car: what is open by more is not held at all, and no covariance of small motions describes it.
_OPEN_M = 3.0


def imprecision(
    sigma_m: float | None, sigma_rad: float | None, config: AcceptanceConfig, margin: float = 1.0
) -> Reason | None:
    """Return why a pose with these standard deviations is uncertain; None if it is precise, or nothing is known.

    Args:
        margin: by which they have to be below the limits.
    """
    if sigma_m is not None and margin * sigma_m > config.max_sigma_m:
        text = f"sigma {1000.0 * sigma_m:.0f} mm, limit {1000.0 * config.max_sigma_m:g} mm"
        return Reason("imprecise", sigma_m, config.max_sigma_m, text)
    sigma_deg = 0.0 if sigma_rad is None else float(np.rad2deg(sigma_rad))
    if margin * sigma_deg > config.max_sigma_deg:
        text = f"sigma {sigma_deg:.2f} deg, limit {config.max_sigma_deg:g} deg"
        return Reason("imprecise", sigma_deg, config.max_sigma_deg, text)
    return None


def unknown_precision(config: AcceptanceConfig) -> Reason:
    """Return why a pose of which no standard deviation is known is not accepted."""
    return Reason("sigma_unknown", np.inf, config.max_sigma_m, "too few surfaces match to tell its sigma")


def place_target(lidar: str, **known: Any) -> LidarPlacement:  # noqa: ANN401 - fields of the placement
    """Place the target, which has the identity."""
    pose = RigidTransform.identity(lidar, lidar)
    return LidarPlacement(lidar, "the target", "placed", pose, fitness=1.0, rmse_m=0.0, **known)


def place(
    pose: RigidTransform,
    covariance: FloatArray | None,
    config: AcceptanceConfig,
    how: str = "placed",
    covered: str = "",
    held: Reason | None = None,
    **known: Any,  # noqa: ANN401 - further fields of the placement
) -> LidarPlacement:
    """Place a LiDAR at an accepted pose; it is uncertain if a standard deviation is above the limit.

    It is not placed where nothing holds the pose in some direction.

    Args:
        covariance: (6, 6), rotation (rad), then translation (m), along the target's axes; None if it is not known.
        how: the LiDAR was placed, for people.
        covered: by the covariance, which is wider for that.
        held: by objects that can move, if so; the covariance is that of the others then.
    """
    doubt = held or (None if covariance is None else imprecision(*weakest_deviations(covariance), config))
    if doubt is not None and covariance is not None and weakest_deviations(covariance)[0] > _OPEN_M:
        reason = f"{OPEN_POSE}: {doubt.text}"
        return LidarPlacement(pose.source, reason, T_target_source_prior=known.get("T_target_source_prior"))
    status: PlacementStatus = "placed" if doubt is None else "uncertain"
    reasons = [how if doubt is None else doubt.text, *([f"{COVERED} {covered}"] if covered else ())]
    return LidarPlacement(
        pose.source, "; ".join(reasons), status, pose, covariance=covariance, held_by_movable=held is not None, **known
    )


def are_contradicted(offsets: Mapping[str, FloatArray], covariances: Mapping[str, FloatArray]) -> bool:
    """Return whether a pose is farther off than its covariance allows.

    If fixed objects contradict the poses by all points, movable ones have moved. That is the test of Hausman
    (Econometrica 1978), cautious as it takes the whole covariance for that of the offset.

    Args:
        offsets: per LiDAR (6,) of its pose from that which is tested.
        covariances: per LiDAR (6, 6) of its pose.
    """
    chances = (chdtrc(off.size, off @ np.linalg.solve(covariances[name], off)) for name, off in offsets.items())
    return bool(min(chances, default=1.0) < LEAST_PROBABILITY)


def held_by_movable(
    covariance: FloatArray, fixed: FloatArray, config: AcceptanceConfig, *, moved: bool = False
) -> Reason | None:
    """Return why a LiDAR is uncertain, if objects that moved, or could have, hold its pose.

    Args:
        covariance: (6, 6) by all points.
        fixed: (6, 6) without the points on objects of the size of vehicles and people that stand free.
        moved: the objects are known to have moved.
    """
    doubt = imprecision(*weakest_deviations(fixed), config)
    growth = max(np.divide(weakest_deviations(fixed), weakest_deviations(covariance)))
    if doubt is None or growth < _HELD_GROWTH:
        return None
    # By the variances, along the direction in which it is largest.
    share = 1.0 - 1.0 / float(np.linalg.eigvals(np.linalg.solve(covariance, fixed)).real.max())
    which = "objects that moved" if moved else "objects that can move"
    unknown = "" if moved else ", and one frame cannot tell whether they did"
    text = f"{which} hold {share:.0%} of its information in one direction{unknown}: without them {doubt.text}"
    return Reason("held_by_movable", doubt.value, doubt.limit, text)


def why_unplaced(
    lidar: str,
    target: str,
    pairs: Sequence[PairRegistration],
    decisions: Sequence[MergeDecision],
    *,
    in_range: Collection[str] = (),
    until: Stage = "ground",
    not_reached: Sequence[PairKey] = (),
) -> str:
    """Return why a calibration does not place a LiDAR.

    Args:
        pairs, decisions: of the calibration.
        in_range: the LiDARs with returns in range; empty if none was examined.
        until: the last stage that was asked for.
        not_reached: pairs for which there was no time.
    """
    if in_range and lidar not in in_range:
        return "it has no returns in range"
    if until in STAGES[: STAGES.index("merge")]:
        return f"the run stopped after stage {until} (--until)"
    if missed := _missed_with(lidar, not_reached):
        return f"the time limit (--max-time) ended the search before its pairs with {missed} were searched"
    best = _best_of(lidar, pairs)
    if best is None:
        return "no pose was found against any other LiDAR"
    (other,) = best.lidars - {lidar}
    why = _last_refusal(lidar, target, decisions[-1]) if best.verdict.counts else best.verdict.text
    return f"its best registration, with {other}: {why}"


def _best_of(lidar: str, pairs: Sequence[PairRegistration]) -> PairRegistration | None:
    return max((pair for pair in pairs if lidar in pair.lidars), key=lambda pair: pair.evidence, default=None)


def _last_refusal(lidar: str, target: str, last: MergeDecision) -> str:
    """Return why the group of a LiDAR with a pair that counts was not merged into the target's."""
    members = next((group for group in last.groups if lidar in group), (lidar,))
    reasons = [each.reason for each in last.candidates if each.names & {*members} and each.reason]
    return reasons[0] if reasons else f"{' and '.join(members)} could not be joined to {target}"


def why_unplaced_jointly(
    lidar: str,
    target: str,
    results: Mapping[str, CalibrationResult],
    conflicts: Mapping[str, Sequence[PoseConflict]],
) -> str:
    """Return why several snapshots together do not place a LiDAR.

    Args:
        results: of each snapshot alone.
        conflicts: per snapshot; the first LiDAR of each is inconsistent.
    """
    undecided = [each for own in conflicts.values() for each in own if each.lidars[0] == lidar and not each.outvoted]
    if undecided:
        return undecided[0].text
    reasons = (_why_not_in(name, result, lidar, target, conflicts[name]) for name, result in results.items())
    return ". ".join(reason for reason in reasons if reason)


def _why_not_in(
    snapshot: str, result: CalibrationResult, lidar: str, target: str, conflicts: Sequence[PoseConflict]
) -> str:
    alone = next((each for each in result.placements if each.lidar == lidar), None)
    if alone is None:
        return ""
    if alone.T_target_source is None:
        return f"{snapshot}: {alone.reason}"
    of_target = next((each for each in result.placements if each.lidar == target), alone)
    if lidar == result.target and of_target.T_target_source is None:
        return f"{snapshot}: {target} is not placed relative to it: {of_target.reason}"
    own = next((conflict for conflict in conflicts if conflict.lidars[0] == lidar), None)
    if own is not None:
        by = f"outvoted by {', '.join(own.others)}"
        return f"{snapshot}: its pose is {by}, {own.distance_m:.3f} m and {own.angle_deg:.2f} deg away"
    if conflicts:
        inconsistent = ", ".join(conflict.lidars[0] for conflict in conflicts)
        return f"{snapshot}: {BY_CONTRADICTING} on {inconsistent}"
    return f"{snapshot}: {alone.status} relative to {result.target}, but no accepted pair connects it to {target}"


def _missed_with(lidar: str, not_reached: Sequence[PairKey]) -> str:
    """Return the other LiDARs of its pairs for which there was no time, as a list in words."""
    return ", ".join(sorted({*chain.from_iterable(pair for pair in not_reached if lidar in pair)} - {lidar}))


def unplaced_near_known(
    lidar: str,
    placed: Collection[str],
    scores: Mapping[PairKey, Registration],
    found: Sequence[PairRegistration],
    config: AcceptanceConfig,
    not_reached: Sequence[PairKey] = (),
) -> LidarPlacement:
    """Return why a LiDAR has no pose near its known one, and whether beams contradict that one.

    Args:
        placed: the LiDARs that have a pose.
        scores: of its known pose with each of these that sees something, relative to where that one is now.
        found: the registrations that were tried from there.
        not_reached: pairs for which there was no time.
    """
    if missed := _missed_with(lidar, not_reached):
        return LidarPlacement(
            lidar, f"the time limit (--max-time) ended the check before its pairs with {missed} were registered"
        )
    contradicted = any(score.visibility.contradiction > config.min_log_odds_margin for score in scores.values())
    best = _best_of(lidar, found)
    if best is not None and best.verdict.counts:
        (other,) = best.lidars - {lidar}
        reason = f"it fits {other}, but nothing links both to {' and '.join(sorted(placed))}"
    elif best is not None:
        (other,) = best.lidars - {lidar}
        reason = f"no pose near the known one fits {other}: {best.verdict.text or 'too few points match'}"
    elif scores:
        reason = f"{TOO_FEW_SURFACES} {' and '.join(sorted(placed))}"
    else:
        reason = "it has no returns in range, or no known pose"
    return LidarPlacement(lidar, reason, contradicts_prior=contradicted)


def contested_place(
    lidar: str,
    poses: Mapping[str, RigidTransform],
    pairs: Sequence[PairRegistration],
    score_pose: ScorePose | None = None,
) -> ContestedPlace | None:
    """Find the two accepted pairs whose poses of a LiDAR are farthest apart; distances are rounded to 1 mm.

    Args:
        lidar: one that is not placed.
        poses: ``T_target_lidar`` of the placed LiDARs.
        score_pose: scores the pose of the first pair that follows from the other; None leaves that out.

    Returns:
        None where all accepted pairs with a placed LiDAR agree.
    """
    places = [
        (pair, poses[fixed] @ pair.T_target_source.with_target(fixed))
        for pair in sorted(pairs, key=lambda pair: -pair.evidence)
        if pair.verdict.accepted and lidar in pair.lidars
        for fixed in pair.lidars - {lidar}
        if fixed in poses
    ]
    apart = [
        (*here.distance_to(there), pair, other, there)
        for (pair, here), (other, there) in combinations(places, 2)
        if is_distinct(here, [there])
    ]
    if not apart:
        return None
    distance_m, angle_rad, pair, other, place = max(apart, key=lambda each: (round(each[0], 3), round(each[1], 3)))
    competing = None
    if score_pose is not None:
        (fixed,) = pair.lidars - {lidar}
        competing = score_pose((poses[fixed].inverse() @ place).with_target(pair.target))
    return ContestedPlace(
        (pair.target, pair.source), (other.target, other.source), distance_m, float(np.rad2deg(angle_rad)), competing
    )
