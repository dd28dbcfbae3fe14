# SPDX-License-Identifier: Apache-2.0
"""Stages that work on pairs of LiDARs."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from multilica import events
from multilica.acceptance.accept import accept, accept_by_fitness
from multilica.acceptance.cycles import check_ambiguous_chains, check_cycle_consistency
from multilica.acceptance.symmetry import check_scene_symmetry
from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.registration_cloud import prepare_registration_cloud
from multilica.results import CoarseResult, Correspondences, Group, Hypothesis, PairKey, PairRegistration, Registration
from multilica.stages.coarse import find_hypotheses
from multilica.stages.correspond import match_features
from multilica.stages.features import compute_features
from multilica.stages.fine import Side, prepare_side, register_best
from multilica.stages.missing_pairs import unconnected_pairs
from multilica.stages.prior import known_between
from multilica.stages.verify import PreparedLidar, short_gicp, verify_hypotheses
from multilica.steps.state import CalibrationState
from multilica.visibility.sensor_view import prepare_sensor_view

__all__ = [
    "find_all_hypotheses",
    "match_pairs",
    "merged_points",
    "register_pair",
    "register_pairs",
    "register_sides",
    "side_of",
    "verify_pairs",
]


def match_pairs(state: CalibrationState) -> None:
    """Match the descriptors of each pair."""
    for target, source in state.pairs:
        matches = match_features(state.features[target], state.features[source], state.config.correspond)
        state.matches[target, source] = matches
        state.observe(events.CorrespondencesMatched(matches))


def find_all_hypotheses(state: CalibrationState) -> None:
    """Find the hypotheses of each pair, that of the prior included."""
    for pair, matches in state.matches.items():
        state.coarse[pair] = _hypotheses(state, matches, known_between(state.prior, *pair))
        state.observe(events.HypothesesFound(state.coarse[pair], matches))


def _hypotheses(state: CalibrationState, matches: Correspondences, prior: RigidTransform | None) -> CoarseResult:
    config = state.config
    return find_hypotheses(matches, config.coarse, config.acceptance.max_baseline_m, config.runtime.seed, prior)


def verify_pairs(state: CalibrationState) -> None:
    """Register and score the hypotheses of each pair."""
    config = state.config
    if not config.verify.enabled:
        return
    gicp = short_gicp(config.verify, config.fine)
    for name, cloud in state.clouds.items():
        rough = prepare_registration_cloud(name, cloud.points_m, gicp, config.runtime.threads)
        state.prepared[name] = PreparedLidar(prepare_sensor_view(cloud, config.visibility), rough)
    for pair, coarse in state.coarse.items():
        state.verified[pair] = _verify(state, coarse)
        state.observe(events.HypothesesVerified(*pair, state.verified[pair]))


def _verify(state: CalibrationState, coarse: CoarseResult) -> tuple[Registration, ...]:
    return verify_hypotheses(state.prepared[coarse.target], state.prepared[coarse.source], coarse, state.config)


def register_pairs(state: CalibrationState) -> None:
    """Register each pair, check the pairs against each other, and search again for pairs that remain unconnected."""
    for name in state.clouds:
        state.sides[name] = side_of(state, Group.of_one(name))
    for pair in state.pairs:
        hypotheses = _as_hypotheses(state.verified[pair]) if state.verified else state.coarse[pair].hypotheses
        if hypotheses:
            state.registrations[pair] = register_pair(state, pair, hypotheses)
            state.observe(events.PairRegistered(state.registrations[pair]))
    _check_pairs(state)
    if state.config.verify.enabled:
        for voxel_size_m in state.config.features.further_voxel_sizes_m:
            _search_again(state, voxel_size_m)


def _as_hypotheses(registrations: Sequence[Registration]) -> list[Hypothesis]:
    return [
        Hypothesis(each.T_target_source, origin=each.origin, index=each.hypothesis, evidence=each.evidence)
        for each in registrations
    ]


def _check_pairs(state: CalibrationState) -> None:
    """Check the accepted pairs against symmetries of the scene, cycles and chains."""
    if not state.prepared:
        return
    limits, stability = state.config.acceptance, state.config.stability
    checks: tuple[Callable[[Sequence[PairRegistration]], list[PairRegistration]], ...] = (
        lambda pairs: check_scene_symmetry(pairs, state.score_pose, limits),
        lambda pairs: check_cycle_consistency(pairs, state.score_pose, limits),
        lambda pairs: check_ambiguous_chains(pairs, state.score_pose, limits, stability),
    )
    for check in checks:
        before = list(state.registrations.items())
        after = check([pair for _, pair in before])
        for (key, old), new in zip(before, after, strict=True):
            if new is not old:
                state.registrations[key] = new
                state.doubted.add(key)
                state.observe(events.VerdictChanged(new))


def _search_again(state: CalibrationState, voxel_size_m: float) -> None:
    """Search for poses of unconnected pairs with descriptors of another size; keep those that are accepted."""
    config = state.config
    pairs = unconnected_pairs(state.pairs, state.registrations, state.doubted)
    if not pairs:
        return
    state.observe(events.SearchWidened(pairs, voxel_size_m))
    of_size = config.features.model_copy(update={"voxel_size_m": voxel_size_m})
    names = sorted({name for pair in pairs for name in pair})
    features = {name: compute_features(state.clouds[name], of_size) for name in names}
    for pair in pairs:
        matches = match_features(features[pair[0]], features[pair[1]], config.correspond)
        coarse = _hypotheses(state, matches, None)
        verified = _verify(state, coarse)
        if not verified:
            continue
        found = register_pair(state, pair, _as_hypotheses(verified))
        if found.verdict.accepted:
            state.matches[pair], state.coarse[pair], state.verified[pair] = matches, coarse, verified
            state.registrations[pair] = found
            state.observe(events.CorrespondencesMatched(matches))
            state.observe(events.HypothesesFound(coarse, matches))
            state.observe(events.HypothesesVerified(*pair, verified))
            state.observe(events.PairRegistered(found))
    _check_pairs(state)


def side_of(state: CalibrationState, group: Group) -> Side:
    """Prepare a LiDAR, or a group with its members in the frame of its root, for registration."""
    if len(group.poses) == 1 and group.root in state.sides:
        return state.sides[group.root]
    placed = sorted(group.poses.items()) if state.prepared else []
    views = [(pose, state.prepared[name].view) for name, pose in placed]
    return prepare_side(group.root, merged_points(state, group), views, state.config)


def merged_points(state: CalibrationState, group: Group) -> FloatArray:
    """Return the points (N, 3) of all members in the frame of the root."""
    return np.concatenate([pose.apply(state.clouds[name].points_m) for name, pose in sorted(group.poses.items())])


def register_sides(
    state: CalibrationState, target: Side, source: Side, hypotheses: Sequence[Hypothesis], *, fit: bool
) -> PairRegistration:
    """Register two sides as `register_best` does, with a verdict."""
    config = state.config
    found = register_best(target, source, hypotheses, config, fit=fit)
    if found.registrations:
        return replace(found, verdict=accept(found.registrations, config.acceptance, config.stability))
    return replace(found, verdict=accept_by_fitness(found, config.merge))


def register_pair(state: CalibrationState, pair: PairKey, hypotheses: Sequence[Hypothesis]) -> PairRegistration:
    """Register two LiDARs as `register_best` does, with a verdict."""
    return register_sides(state, state.sides[pair[0]], state.sides[pair[1]], hypotheses, fit=True)
