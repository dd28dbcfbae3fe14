# SPDX-License-Identifier: Apache-2.0
"""Stages that work on the whole rig."""

from collections.abc import Mapping, Sequence

import numpy as np

from multilica import events
from multilica.acceptance.rig import is_contradicted
from multilica.config import CalibrationConfig
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.orchestration.pairs import SearchRequest, register_sides, search_pair
from multilica.orchestration.prepared_lidar import prepare_lidar
from multilica.orchestration.state import CalibrationState
from multilica.results import GroundPlane, Group, Hypothesis, PairRegistration, PreprocessedCloud
from multilica.snapshot import Snapshot
from multilica.stages.fine import RegistrationCloud, prepare_registration_cloud, select_finalists
from multilica.stages.ground import estimate_ground, middle_of
from multilica.stages.group_registration import poses_between, register_groups
from multilica.stages.known_poses import known_in_base
from multilica.stages.merge import merge_along_graph, merge_by_fitness, merge_target_first
from multilica.stages.refine import refine, trusted_pairs
from multilica.stages.target import choose_target


def merge_pairs(state: CalibrationState) -> None:
    """Choose the target, and merge accepted pairs into its group."""
    registrations, names, config = tuple(state.registrations.values()), tuple(state.clouds), state.config.merge
    state.target, state.target_reason = choose_target(state.config.target, state.clouds, registrations)
    state.observe(events.TargetChosen(state.target, state.target_reason))
    state.group = Group.of_one(state.target)

    def register(group: Group, other: Group, pairs: Sequence[PairRegistration]) -> PairRegistration | None:
        return _register_groups(state, group, other, pairs)

    def register_again(group: Group, other: Group, pair: PairRegistration) -> PairRegistration | None:
        if state.config.verify.enabled:
            return _register_groups(state, group, other, [pair])
        return _register_from_coarse(state, group, other)

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
            state.merges.append(step.chosen)
        state.group = step.groups[0]
        state.observe(events.MergeStepTaken(step.decision, tuple(step.grown.poses.values())))


def _register_groups(
    state: CalibrationState, group: Group, other: Group, pairs: Sequence[PairRegistration]
) -> PairRegistration | None:
    acceptance, most = state.config.acceptance, state.config.fine.max_finalists
    contradicted = {key for key, pair in state.registrations.items() if is_contradicted(pair)}
    finalists = {
        pair: [verified[index] for index in select_finalists([each.evidence for each in verified], acceptance, most)]
        for pair, verified in state.verified.items()
        if pair not in contradicted
    }

    def register(group: Group, other: Group, hypotheses: Sequence[Hypothesis], fit: bool) -> PairRegistration:
        return register_sides(_side_of(state, group), _side_of(state, other), hypotheses, state.config, fit=fit)

    found = register_groups(group, other, pairs, poses_between(group, other, finalists), register, state.config)
    if found is not None:
        state.observe(events.GroupsRegistered(found))
    return found


def _register_from_coarse(state: CalibrationState, group: Group, other: Group) -> PairRegistration:
    """Register two groups from the coarse pose of their roots."""
    start = state.coarse[group.root, other.root].hypotheses[0]
    found = register_sides(_side_of(state, group), _side_of(state, other), [start], state.config)
    state.observe(events.GroupsRegistered(found))
    return found


def _search_merged(state: CalibrationState, group: Group, other: Group) -> PairRegistration | None:
    """Search the pose of a single LiDAR in the merged cloud of a group, without an initial guess."""
    if group.members not in state.merged_lidars:
        points_m = _merged_points(state, group)
        cloud = PreprocessedCloud(group.root, np.empty((0, 3), dtype=np.float32), points_m)
        state.merged_lidars[group.members] = prepare_lidar(cloud, state.config)
    lidars = {group.root: state.merged_lidars[group.members], other.root: state.lidars[other.root]}
    request = SearchRequest((group.root, other.root), state.config.features.voxel_size_m)
    found = search_pair(lidars, request).registration
    if found is not None:
        state.observe(events.GroupsRegistered(found))
    return found


def _side_of(state: CalibrationState, group: Group) -> RegistrationCloud:
    """Prepare a LiDAR, or a group with its members in the frame of its root, for registration."""
    if len(group.poses) == 1:
        return state.lidars[group.root].side
    if group.members not in state.sides:
        views = [
            (pose, view) for name, pose in sorted(group.poses.items()) if (view := state.lidars[name].view) is not None
        ]
        state.sides[group.members] = prepare_registration_cloud(
            group.root, _merged_points(state, group), views, state.config
        )
    return state.sides[group.members]


def _merged_points(state: CalibrationState, group: Group) -> FloatArray:
    """Return the points (N, 3) of all members in the frame of the root."""
    return np.concatenate([pose.apply(state.clouds[name].points_m) for name, pose in sorted(group.poses.items())])


def refine_rig(state: CalibrationState) -> None:
    """Refine all poses jointly."""
    if not state.config.refine.enabled or state.group is None:
        return
    trusted = trusted_pairs(state.registrations.values(), state.merges)
    rig = refine(state.target, state.group.poses, trusted, state.config.refine)
    state.group = Group(state.target, rig.poses)
    state.covariances, state.refinement = rig.covariances, rig.refinement
    state.observe(events.RigRefined(rig.refinement, tuple(pose for _, pose in sorted(rig.poses.items()))))


def fit_ground(state: CalibrationState) -> None:
    """Fit the ground plane to the merged cloud, if the configuration asks for it."""
    if not state.config.ground.enabled or state.group is None:
        return
    clouds = {name: cloud.points_m for name, cloud in state.clouds.items()}
    state.ground, reason = ground_under(state.snapshot, state.target, clouds, state.poses, state.config, state.rig)
    state.ground_refusal = "" if state.ground else reason
    state.observe(events.GroundEstimated(state.ground, reason))


def ground_under(
    snapshot: Snapshot,
    target: str,
    clouds: Mapping[str, FloatArray],
    poses: Mapping[str, RigidTransform],
    config: CalibrationConfig,
    rig: Extrinsics | None,
) -> tuple[GroundPlane | None, str]:
    """Estimate the ground from the clouds of the placed LiDARs, as `estimate_ground`.

    Args:
        clouds: per LiDAR (N, 3) in its own frame.
        poses: ``T_target_lidar`` of the placed LiDARs.
        rig: has the pose of the target in the base frame.
    """
    known = None
    if rig is not None:
        known = known_in_base(rig, config.ground.frame, snapshot[target])
        if known is None:
            return None, f"the rig file has no pose of the target {target}"
    points_m = np.concatenate([pose.apply(clouds[name]) for name, pose in sorted(poses.items()) if name in clouds])
    return estimate_ground(target, points_m, config, middle_of(poses), known)
