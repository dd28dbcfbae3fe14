# SPDX-License-Identifier: Apache-2.0
"""Stages that work on pairs of LiDARs."""

from collections.abc import Callable, Sequence

from multilica import events
from multilica.acceptance.cycles import check_ambiguous_chains, check_cycle_consistency
from multilica.acceptance.symmetry import check_scene_symmetry
from multilica.geometry import RigidTransform
from multilica.registration.registration_cloud import prepare_registration_cloud
from multilica.results import (
    CoarseResult,
    Correspondences,
    Group,
    Hypothesis,
    PairRegistration,
    Registration,
)
from multilica.stages.coarse import find_hypotheses
from multilica.stages.correspond import match_features
from multilica.stages.features import compute_features
from multilica.stages.prior import known_between
from multilica.stages.verify import PreparedLidar, VerifySettings, short_gicp, verify_hypotheses
from multilica.stages.wider_search import unconnected_pairs
from multilica.steps.sides import register_pair, side_of
from multilica.steps.state import CalibrationState
from multilica.visibility.sensor_view import prepare_sensor_view

__all__ = ["find_all_hypotheses", "match_pairs", "register_pairs", "verify_pairs"]


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
    config = state.config
    gicp = short_gicp(config.verify, config.fine)
    settings = VerifySettings(config.verify, config.visibility, config.acceptance, gicp, config.runtime.threads)
    return verify_hypotheses(state.prepared[coarse.target], state.prepared[coarse.source], coarse, settings)


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
