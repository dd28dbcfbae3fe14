# SPDX-License-Identifier: Apache-2.0
"""Outcome of a calibration: a pose or a reason per LiDAR."""

from collections.abc import Mapping, Sequence
from itertools import chain, combinations

from multilica.acceptance.accept import imprecision
from multilica.config import STAGES
from multilica.geometry import RigidTransform
from multilica.orchestration.state import CalibrationState
from multilica.registration.poses import is_distinct
from multilica.results import (
    LEVEL_FRAME,
    CalibrationResult,
    ContestedPlace,
    LidarPlacement,
    MergeDecision,
    PairRegistration,
    Refusal,
    TimeLimit,
)
from multilica.results.registrations import weakest_deviations
from multilica.stages.ground import estimate_level
from multilica.stages.prior import known_between
from multilica.stages.refine import trusted_pairs
from multilica.visibility.sensor_view import ScorePose


def result_of(state: CalibrationState) -> CalibrationResult:
    """Return the outcome as far as the stages went."""
    target = state.target or state.config.target or state.snapshot.names[0]
    return CalibrationResult(
        target=target,
        target_reason=state.target_reason or "no pair was registered",
        placements=tuple(placement_of(name, target, state) for name in state.snapshot.names),
        pairs=tuple(state.registrations.values()),
        decisions=tuple(state.decisions),
        refinement=state.refinement,
        ground=state.ground,
        ground_refusal=state.ground_refusal,
        time_limit=TimeLimit(state.config.runtime.max_time_s, state.not_reached) if state.cut_short else None,
        trusted=tuple(trusted_pairs(state.registrations.values(), state.merges)),
        timing_s=dict(state.timing_s),
        health=tuple(state.health),
        level=_level(state, target),
    )


def refused(state: CalibrationState, refusal: Refusal) -> CalibrationResult:
    """Return the outcome of a refused snapshot: no LiDAR is placed, not even the target."""
    return CalibrationResult(
        target=state.config.target or state.snapshot.names[0],
        target_reason="the snapshot was refused",
        placements=tuple(LidarPlacement(name, reason=refusal.text) for name in state.snapshot.names),
        timing_s=dict(state.timing_s),
        health=tuple(state.health),
        refusal=refusal,
    )


def _level(state: CalibrationState, target: str) -> RigidTransform | None:
    """Return the pose of the target in a frame with z up, from the ground plane or a quick estimate of it."""
    if state.ground is not None:
        return RigidTransform(LEVEL_FRAME, target, state.ground.T_base_target.matrix)
    clouds = {name: cloud.points_m for name, cloud in state.clouds.items()}
    return estimate_level(target, clouds, state.poses, state.config)


def placement_of(name: str, target: str, state: CalibrationState) -> LidarPlacement:
    """Return the LiDAR's pose with its figures, or why it has none."""
    poses = state.poses
    claimed = known_between(state.prior, target, name)
    if name == target:
        pose = RigidTransform.identity(name, name)
        return LidarPlacement(name, "the target", "placed", pose, 1.0, 0.0, T_target_source_prior=claimed)
    if name not in poses:
        pairs, score_pose = tuple(state.registrations.values()), state.score_pose if state.lidars else None
        score_pose = score_pose if state.config.verify.enabled else None
        contested = contested_place(name, poses, pairs, score_pose)
        return LidarPlacement(name, _reason(name, target, state), T_target_source_prior=claimed, contested=contested)
    chosen = (decision.chosen for decision in state.decisions if name in decision.groups[0])
    merged = next(candidate for candidate in chosen if candidate is not None)
    covariance = state.covariances.get(name)
    doubt = None if covariance is None else imprecision(*weakest_deviations(covariance), state.config.acceptance)
    return LidarPlacement(
        name,
        "placed" if doubt is None else doubt.text,
        "placed" if doubt is None else "uncertain",
        poses[name],
        merged.fitness,
        merged.rmse_m,
        covariance,
        claimed,
    )


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
    return ContestedPlace((pair.target, pair.source), (other.target, other.source), distance_m, angle_rad, competing)


def _reason(name: str, target: str, state: CalibrationState) -> str:
    if name not in state.clouds and state.clouds:
        return "it has no returns in range"
    if state.config.until in STAGES[: STAGES.index("merge")]:
        return f"the run stopped after stage {state.config.until} (--until)"
    missed = sorted({*chain.from_iterable(pair for pair in state.not_reached if name in pair)} - {name})
    if missed:
        return f"the time was over (--max-time) before its pairs with {', '.join(missed)} were searched"
    own = [pair for pair in state.registrations.values() if name in pair.lidars]
    if not own:
        return "no pose was found against any other LiDAR"
    best = max(own, key=lambda pair: pair.evidence)
    (other,) = best.lidars - {name}
    why = best.verdict.text or _last_refusal(name, target, state.decisions[-1])
    return f"its best registration, with {other}: {why}"


def _last_refusal(name: str, target: str, last: MergeDecision) -> str:
    """Return why the group of a LiDAR with an accepted pair was not merged into the target's."""
    members = next((group for group in last.groups if name in group), (name,))
    reasons = [each.reason for each in last.candidates if {each.target, each.source} & {*members} and each.reason]
    return reasons[0] if reasons else f"{' and '.join(members)} could not be joined to {target}"
