# SPDX-License-Identifier: Apache-2.0
"""Stages that work on the whole rig, and the result that follows."""

import sys
from collections.abc import Mapping, Sequence

import numpy as np

from multilica import events
from multilica.acceptance.placement import contested_place, place, place_target, why_unplaced
from multilica.acceptance.rig import is_contradicted
from multilica.config import CalibrationConfig
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.orchestration.lone_pairs import doubt_merge
from multilica.orchestration.member_pairs import fit_members
from multilica.orchestration.pairs import SearchRequest, prepare_lidar, register_sides, search_pair
from multilica.orchestration.state import CalibrationState
from multilica.results import (
    LEVEL_FRAME,
    CalibrationResult,
    GroundPlane,
    Group,
    Hypothesis,
    LidarPlacement,
    PairKey,
    PairRegistration,
    PreprocessedCloud,
    Refusal,
    SensorBias,
    connected,
)
from multilica.snapshot import Snapshot
from multilica.stages.fine import select_finalists
from multilica.stages.ground import (
    estimate_ground,
    estimate_ground_over,
    estimate_level,
    find_levels,
    level_near,
    middle_of,
)
from multilica.stages.known_poses import known_between, known_in_base
from multilica.stages.merge import (
    merge_along_graph,
    merge_by_fitness,
    merge_target_first,
    poses_between,
    register_groups,
)
from multilica.stages.pair_choice import choose_target
from multilica.stages.refine import trusted_pairs
from multilica.stages.surface_distances import PairMatches, match_surfaces, residuals_of
from multilica.visibility.registration_cloud import RegistrationCloud
from multilica.workers import Shared

# Enough to see where a pair does not meet; `--record full` has all.
_ENOUGH_MATCHES = 2000


def merge_pairs(state: CalibrationState) -> None:
    """Choose the target, and merge accepted pairs into its group."""
    registrations, names, config = tuple(state.registrations.values()), tuple(state.clouds), state.config.merge
    state.target, state.target_reason = choose_target(state.config.target, state.clouds, registrations)
    state.observe(events.TargetChosen(state.target, state.target_reason))
    state.group = Group.of_one(state.target)
    groups: dict[PairKey, tuple[Group, Group]] = {}

    def register(group: Group, other: Group, pairs: Sequence[PairRegistration]) -> PairRegistration | None:
        found = _register_groups(state, group, other, pairs)
        groups.update(_groups_of(found, group, other))
        return found

    def register_again(group: Group, other: Group, pair: PairRegistration) -> PairRegistration | None:
        if state.config.verify.enabled:
            return _register_groups(state, group, other, [pair])
        start = state.coarse[group.root, other.root].hypotheses[0]
        found = register_sides(_side_of(state, group), _side_of(state, other), [start], state.config)
        state.observe(events.GroupsRegistered(found))
        return found

    def register_rest(group: Group, other: Group) -> PairRegistration | None:
        if state.config.verify.enabled:
            between = [pair for pair in registrations if pair.lidars & {*group.poses} and pair.lidars & {*other.poses}]
            return _register_groups(state, group, other, between)
        return _search_merged(state, group, other)

    if config.mode == "graph":
        steps = merge_along_graph(state.target, names, registrations, register)
    elif config.mode == "algorithm1":
        steps = merge_by_fitness(state.target, names, registrations, register_again)
    else:
        steps = merge_target_first(state.target, names, registrations, register_rest)
    for step in steps:
        state.decisions.append(step.decision)
        if step.chosen is not None:
            state.merges.append(_member_pairs(state, step.chosen, groups))
        state.group = step.groups[0]
        state.observe(events.MergeStepTaken(step.decision, tuple(step.grown.poses.values())))


def _groups_of(found: PairRegistration | None, *groups: Group) -> dict[PairKey, tuple[Group, Group]]:
    """Return the target's and the source's group of a registration; either of both is its target."""
    if found is None:
        return {}
    of_roots = {group.root: group for group in groups}
    return {(found.target, found.source): (of_roots[found.target], of_roots[found.source])}


def _member_pairs(
    state: CalibrationState, merge: PairRegistration, groups: Mapping[PairKey, tuple[Group, Group]]
) -> tuple[PairRegistration, ...]:
    """Return the registrations of a merge's members if no accepted pair connects the groups, else its own."""
    key = merge.target, merge.source
    if key not in groups or not state.config.refine.enabled or merge.source in connected(merge.target, state.accepted):
        return (merge,)
    return fit_members(merge, *groups[key], state.lidars, state.config.refine)


def _register_groups(
    state: CalibrationState, group: Group, other: Group, pairs: Sequence[PairRegistration]
) -> PairRegistration | None:
    acceptance, most = state.config.acceptance, state.config.fine.max_finalists
    contradicted = {key for key, pair in state.registrations.items() if is_contradicted(pair)}
    finalists = {
        pair: [
            verified[index]
            for index in select_finalists([each.evidence_beside(verified[0]) for each in verified], acceptance, most)
        ]
        for pair, verified in state.verified.items()
        if pair not in contradicted
    }

    def register(group: Group, other: Group, hypotheses: Sequence[Hypothesis], fit: bool) -> PairRegistration:
        return register_sides(_side_of(state, group), _side_of(state, other), hypotheses, state.config, fit=fit)

    found = register_groups(group, other, pairs, poses_between(group, other, finalists), register, state.config)
    if found is not None:
        found = doubt_merge(state, found, _groups_of(found, group, other)[found.target, found.source], pairs)
        state.observe(events.GroupsRegistered(found))
    return found


def _search_merged(state: CalibrationState, group: Group, other: Group) -> PairRegistration | None:
    """Search the pose of a single LiDAR in the merged cloud of a group, without an initial guess."""
    if group.members not in state.merged_lidars:
        points_m = state.points_of(group.poses)
        elevation_axis = state.clouds[group.root].elevation_axis
        no_returns = np.empty((0, 3), dtype=np.float32)
        cloud = PreprocessedCloud(group.root, no_returns, points_m, elevation_axis=elevation_axis)
        state.merged_lidars[group.members] = prepare_lidar(cloud, state.config)
    lidars = {group.root: state.merged_lidars[group.members], other.root: state.lidars[other.root]}
    pair = group.root, other.root
    found = search_pair(lidars, SearchRequest(pair, state.config.features.voxel_size_m, deadline_s=state.deadline_s))
    if found is None:
        state.cut_short = True
        return None
    if found.registration is not None:
        state.observe(events.GroupsRegistered(found.registration))
    return found.registration


def _side_of(state: CalibrationState, group: Group) -> RegistrationCloud:
    """Prepare a group for registration, once."""
    if group.members not in state.sides:
        state.sides[group.members] = state.side_of(group.root, group.poses)
    return state.sides[group.members]


def compare_surfaces(state: CalibrationState) -> None:
    """Report the matches of each registered pair, and the residual of the merged cloud at each placed LiDAR."""
    if state.observe is events.ignore:
        return
    # The pose in the rig; that of the registration where the rig lacks one of the two.
    poses = {
        (target, source): state.poses[target].inverse() @ state.poses[source]
        if {target, source} <= {*state.poses}
        else pair.T_target_source
        for (target, source), pair in sorted(state.registrations.items())
    }
    compared = dict(zip(poses, state.workers.map(compare_pair, list(poses.values())), strict=True))
    of_lidar: dict[str, list[PairMatches]] = {}
    for key, both_ways in compared.items():
        state.observe(events.SurfacesMatched(both_ways[0][0]))
        if state.registrations[key].verdict.accepted and {*key} <= {*state.poses}:
            for each in both_ways:
                of_lidar.setdefault(each[0].source, []).append(each)
    for name, found in sorted(of_lidar.items()):
        state.observe(events.ResidualsMeasured(residuals_of(state.lidars[name].side.cloud, found)))


def compare_pair(lidars: Shared, pose: RigidTransform) -> tuple[PairMatches, PairMatches]:
    """Match the points of the source in the target, and the other way round, a task for a worker."""
    target, source = lidars[pose.target], lidars[pose.source]
    clouds, config = (target.side.cloud, source.side.cloud), target.config
    most = sys.maxsize if config.record.detail == "full" else _ENOUGH_MATCHES
    limits = config.fine.fitness_distance_m, most
    return match_surfaces(*clouds, pose, *limits), match_surfaces(*clouds[::-1], pose.inverse(), *limits)


def fit_ground(state: CalibrationState) -> None:
    """Fit the ground plane to the merged cloud, if the configuration asks for it."""
    if not state.config.ground.enabled or state.group is None:
        return
    clouds = {name: cloud.points_m for name, cloud in state.clouds.items()}
    biases = () if state.refinement is None else state.refinement.biases
    state.ground, reason = ground_under(
        state.snapshot, state.target, clouds, state.poses, state.config, state.rig, biases
    )
    state.ground_refusal = "" if state.ground else reason
    state.observe(events.GroundEstimated(state.ground, reason))


def ground_under(
    snapshot: Snapshot,
    target: str,
    clouds: Mapping[str, FloatArray],
    poses: Mapping[str, RigidTransform],
    config: CalibrationConfig,
    rig: Extrinsics | None,
    biases: Sequence[SensorBias] = (),
) -> tuple[GroundPlane | None, str]:
    """Estimate the ground from the clouds of the placed LiDARs, as `estimate_ground`.

    Args:
        clouds: per LiDAR (N, 3) in its own frame.
        poses: ``T_target_lidar`` of the placed LiDARs.
        rig: has the pose of the target in the base frame.
        biases: of the LiDARs, if they were estimated.
    """
    known = None
    if rig is not None:
        known = known_in_base(rig, config.ground.frame, snapshot[target])
        if known is None:
            return None, f"the rig file has no pose of the target {target}"
    points_m = np.concatenate([pose.apply(clouds[name]) for name, pose in sorted(poses.items()) if name in clouds])
    middle_m = middle_of(poses)
    if known is not None:
        return estimate_ground_over([level_near(known)], points_m, config, middle_m, known, biases)
    found = estimate_ground(target, points_m, config, middle_m, biases=biases)
    if found[0] is None and (levels := find_levels(target, clouds, poses, config)):
        over = estimate_ground_over(levels, points_m, config, middle_m, biases=biases)
        return found if over[0] is None else over
    return found


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
        time_limit=state.time_limit,
        trusted=tuple(
            state.slow_motion.added_to_pair(state.fixed_pairs.get((pair.target, pair.source), pair))
            for pair in trusted_pairs(state.registrations.values(), state.merges)
        ),
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
    if state.level is not None:
        return state.level
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
        covered=state.doubts.get(name, ""),
        held=state.held.get(name),
        repeatability=state.repeatability.get(name),
        fitness=merged.fitness,
        rmse_m=merged.rmse_m,
        T_target_source_prior=claimed,
    )
