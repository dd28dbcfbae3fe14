# SPDX-License-Identifier: Apache-2.0
"""Stages that work on the whole rig."""

from collections.abc import Sequence
from functools import partial

from multilica import events
from multilica.acceptance.cycles import is_contradicted
from multilica.results import Group, Hypothesis, PairRegistration
from multilica.stages.fine import select_finalists
from multilica.stages.ground import estimate_ground
from multilica.stages.group_registration import poses_between, register_groups
from multilica.stages.merge import merge
from multilica.stages.missing_pairs import open_loops
from multilica.stages.refine import refine, trusted_pairs
from multilica.stages.target import choose_target
from multilica.steps.pairs import merged_points, register_pair, register_sides, side_of
from multilica.steps.state import CalibrationState

__all__ = ["fit_ground", "merge_pairs", "refine_rig"]


def merge_pairs(state: CalibrationState) -> None:
    """Choose the target, and merge accepted pairs into its group."""
    registrations = tuple(state.registrations.values())
    state.target, state.target_reason = choose_target(state.config.target, state.clouds, registrations)
    state.observe(events.TargetChosen(state.target, state.target_reason))
    state.group = Group.of_one(state.target)
    reregister = partial(_reregister, state)
    for step in merge(state.target, tuple(state.clouds), registrations, reregister, state.config.merge):
        state.decisions.append(step.decision)
        if step.chosen is not None:
            state.merges.append(step.chosen)
        state.group = step.groups[0]
        state.observe(events.MergeStepTaken(step.decision, tuple(step.grown.poses.values())))


def _reregister(
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
        return register_sides(state, side_of(state, group), side_of(state, other), hypotheses, fit=fit)

    found = register_groups(group, other, pairs, poses_between(group, other, finalists), register, state.config)
    if found is not None:
        state.observe(events.GroupsRegistered(found))
    return found


def refine_rig(state: CalibrationState) -> None:
    """Close the loops that the search left open, and refine all poses jointly."""
    if not state.config.refine.enabled or state.group is None:
        return
    if state.config.verify.enabled:
        for pair, pose in open_loops(state.group, state.pairs, state.registrations).items():
            found = register_pair(state, pair, [Hypothesis(pose)])
            state.observe(events.LoopRegistered(found))
            if found.verdict.accepted:
                state.registrations[pair] = found
    trusted = trusted_pairs(state.registrations.values(), state.merges)
    rig = refine(state.target, state.group.poses, trusted, state.config.refine)
    state.group = Group(state.target, rig.poses)
    state.covariances, state.refinement = rig.covariances, rig.refinement
    state.observe(events.RigRefined(rig.refinement, tuple(pose for _, pose in sorted(rig.poses.items()))))


def fit_ground(state: CalibrationState) -> None:
    """Fit the ground plane to the merged cloud, if the configuration asks for it."""
    if not state.config.ground.enabled or state.group is None:
        return
    points_m = merged_points(state, state.group)
    state.ground, reason = estimate_ground(state.target, points_m, state.config.ground, state.config.runtime.seed)
    state.observe(events.GroundEstimated(state.ground, reason))
