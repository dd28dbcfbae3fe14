# SPDX-License-Identifier: Apache-2.0
"""Outcome of a calibration: a pose or a reason per LiDAR."""

from multilica.acceptance.placement import contested_place, place, place_target, why_unplaced
from multilica.geometry import RigidTransform
from multilica.orchestration.state import CalibrationState
from multilica.results import LEVEL_FRAME, CalibrationResult, LidarPlacement, Refusal, TimeLimit
from multilica.stages.ground import estimate_level
from multilica.stages.known_poses import known_between
from multilica.stages.refine import trusted_pairs


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
    poses, pairs = state.poses, tuple(state.registrations.values())
    claimed = known_between(state.prior, target, name)
    if name == target:
        return place_target(name, T_target_source_prior=claimed)
    if name not in poses:
        score_pose = state.score_pose if state.lidars and state.config.verify.enabled else None
        reason = why_unplaced(
            name,
            target,
            pairs,
            state.decisions,
            in_range=state.clouds,
            until=state.config.until,
            not_reached=state.not_reached,
        )
        contested = contested_place(name, poses, pairs, score_pose)
        return LidarPlacement(name, reason, T_target_source_prior=claimed, contested=contested)
    chosen = (decision.chosen for decision in state.decisions if name in decision.groups[0])
    merged = next(candidate for candidate in chosen if candidate is not None)
    return place(
        poses[name],
        state.covariances.get(name),
        state.config.acceptance,
        fitness=merged.fitness,
        rmse_m=merged.rmse_m,
        T_target_source_prior=claimed,
    )
