# SPDX-License-Identifier: Apache-2.0
"""Search for the poses of pairs until accepted pairs link all LiDARs."""

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence

from multilica import events
from multilica.acceptance.pair_graph import PairGraph
from multilica.acceptance.rig import (
    check_ambiguous_chains,
    check_cycles,
    check_scene_symmetry,
    check_shared_repetition,
)
from multilica.config import Stage
from multilica.geometry import RigidTransform
from multilica.orchestration.lone_pairs import doubt_lone_pairs
from multilica.orchestration.pairs import (
    PAIR_STAGES,
    SearchRequest,
    priority_of,
    register_implied,
    score_implied,
    search_pair,
)
from multilica.orchestration.state import CalibrationState
from multilica.registration.poses import is_distinct
from multilica.results import Hypothesis, PairKey, PairRegistration
from multilica.stages.known_poses import known_between
from multilica.stages.pair_choice import (
    LEAST_PRIORITY,
    choose_loops,
    choose_target,
    components,
    implied_poses,
    is_open,
    next_round,
    pairs_by_role,
)


def search_pairs(state: CalibrationState, until: Stage = "fine") -> None:
    """Search the most promising pairs first, until accepted pairs link all LiDARs or none is left to search.

    A pair that accepted pairs link is not searched: its pose follows from theirs. The beams of its LiDARs test that
    pose, and where it contradicts them the pair is searched as well.

    Args:
        until: the last stage to run; before `fine`, all pairs are searched so far.
    """
    try:
        _search_all(state, until)
        if state.config.verify.enabled and until == "fine":
            doubt_lone_pairs(state)
    finally:
        if state.cut_short:
            group = components(list(state.clouds), [(pair.target, pair.source) for pair in state.accepted])
            wanted = state.pairs if state.config.verify.enabled else _by_mode(state)
            state.not_reached = tuple(
                pair for pair in wanted if pair not in state.coarse and group[pair[0]] != group[pair[1]]
            )


def _search_all(state: CalibrationState, until: Stage) -> None:
    usual = state.config.features.voxel_size_m
    if not state.config.verify.enabled:
        _search(state, _by_mode(state), usual, until)
        return
    if until != "fine":
        _search(state, state.pairs, usual, until)
        return
    start_s = time.perf_counter()
    priority = dict(zip(state.pairs, state.workers.map(priority_of, state.pairs), strict=True))
    state.timing_s["correspond"] = time.perf_counter() - start_s
    _try_earlier(state)
    unpromising = {pair for pair in state.earlier.vain if priority.get(pair, 0.0) < LEAST_PRIORITY}
    for voxel_size_m in (usual, *state.config.features.retry_voxel_sizes_m):
        tried = unpromising.copy()
        if voxel_size_m != usual:
            # Other descriptors cannot help where a pose was found and others fit as well.
            tried |= {pair for pair, found in state.registrations.items() if found.verdict.outcome != "reject"}
            tried.update(state.earlier.vain)
        while True:
            accepted = [(pair.target, pair.source) for pair in state.accepted]
            pairs = next_round(list(state.clouds), accepted, tried, priority)
            if pairs and state.out_of_time:
                state.cut_short, pairs = True, []
            if not pairs and not _close_loops(state, tried):
                break
            if pairs and voxel_size_m != usual:
                state.observe(events.SearchWidened(tuple(pairs), voxel_size_m))
            tried.update(pairs)
            _search(state, pairs, voxel_size_m)


def _by_mode(state: CalibrationState) -> list[PairKey]:
    """Return the pairs to search where beams verify nothing."""
    target, _ = choose_target(state.config.target, state.clouds, ())
    return pairs_by_role(list(state.clouds), target, state.config.merge.mode)


def _try_earlier(state: CalibrationState) -> None:
    """Register pairs from the poses that earlier stops of the drive found, where the beams do not contradict them."""
    names = {*state.clouds}
    poses = {pair: pose for pair, pose in state.earlier.poses.items() if {*pair} <= names}
    _register_implied(state, poses, dict.fromkeys(poses, "earlier stop"))


def _search(
    state: CalibrationState,
    pairs: Sequence[PairKey],
    voxel_size_m: float,
    until: Stage = "fine",
    *,
    whatever_the_time: bool = False,
) -> None:
    """Search pairs; a pair that was searched before with other descriptors is replaced only if it is accepted now."""
    deadline_s = math.inf if whatever_the_time else state.deadline_s
    requests = [
        SearchRequest(pair, voxel_size_m, known_between(state.prior, *pair), until, _refused(state, pair), deadline_s)
        for pair in pairs
    ]
    for pair, found in zip(pairs, state.workers.map(search_pair, requests), strict=True):
        if found is None:
            state.cut_short = True
            continue
        for stage in PAIR_STAGES:
            state.timing_s[stage] = state.timing_s.get(stage, 0.0) + found.elapsed_s.get(stage, 0.0)
        if pair in state.coarse and not (found.registration and found.registration.verdict.accepted):
            continue
        state.observe(events.CorrespondencesMatched(found.matches))
        if found.coarse is not None:
            state.coarse[pair] = found.coarse
            state.observe(events.HypothesesFound(found.coarse, found.matches))
        if found.verified is not None:
            state.verified[pair] = found.verified
            state.observe(events.HypothesesVerified(*pair, found.verified))
        if found.registration is not None:
            state.registrations[pair] = state.searched[pair] = found.registration
            state.observe(events.PairRegistered(found.registration))


def _refused(state: CalibrationState, pair: PairKey) -> tuple[RigidTransform, ...] | None:
    """Return the poses of an earlier search of the pair; None if there was none."""
    if pair not in state.coarse:
        return None
    return tuple(each.T_target_source.with_target(pair[0]) for each in state.verified.get(pair, ()))


def _close_loops(state: CalibrationState, searched: set[PairKey]) -> bool:
    """Test the poses of pairs that accepted pairs link, and check the accepted pairs against each other.

    Returns:
        True if a verdict changed, so that pairs may have to be searched.
    """
    poses = {
        pair: pose
        for pair, pose in implied_poses(state.clouds, state.pairs, state.accepted).items()
        if pair not in state.tested_loops and is_open(state.registrations.get(pair), pose)
    }
    state.tested_loops.update(poses)
    graph = PairGraph.of(state.clouds, state.accepted)
    state.implied_by |= {pair: [each.lidars for each in graph.path(*pair)] for pair in poses}
    contradicted = _register_implied(state, poses, {pair: "-".join(graph.lidars_between(*pair)) for pair in poses})
    pairs = sorted(contradicted - searched)
    searched.update(pairs)
    # Without them, a wrong pair could pass.
    _search(state, pairs, state.config.features.voxel_size_m, whatever_the_time=True)
    return _check_pairs(state)


def _register_implied(
    state: CalibrationState, poses: Mapping[PairKey, RigidTransform], derivations: Mapping[PairKey, str]
) -> set[PairKey]:
    """Register pairs from poses that other pairs or stops imply, those with the most common surfaces.

    Returns:
        The pairs whose beams contradict that pose, or whose registration moved away from it.
    """
    limits = state.config.acceptance
    scores = dict(zip(poses, state.workers.map(score_implied, list(poses.values())), strict=True))
    state.remember(scores.values())
    contradicted = {
        pair for pair, score in scores.items() if score.visibility.contradiction > limits.min_log_odds_margin
    }
    chosen = choose_loops(
        {pair: score for pair, score in scores.items() if pair not in contradicted}, limits.min_evidence
    )
    if chosen and state.out_of_time:
        state.cut_short, chosen = True, []
    starts = [Hypothesis(poses[pair], derivation=derivations[pair]) for pair in chosen]
    registered = state.workers.map(register_implied, starts)
    for pair, found in zip(chosen, registered, strict=True):
        if is_distinct(poses[pair], [found.T_target_source.with_target(pair[0])]):  # it moved away from it
            contradicted.add(pair)
            continue
        state.observe(events.LoopRegistered(found))
        if found.verdict.accepted:
            state.registrations[pair] = found
    return contradicted


def _check_pairs(state: CalibrationState) -> bool:
    """Check the accepted pairs against symmetries of the scene, cycles and chains."""
    limits = state.config.acceptance
    checks: tuple[Callable[[Sequence[PairRegistration]], list[PairRegistration]], ...] = (
        lambda pairs: check_scene_symmetry(pairs, state.score_rough_pose, limits),
        lambda pairs: check_cycles(pairs, state.score_pose, limits),
        lambda pairs: check_ambiguous_chains(pairs, state.score_pose, limits),
        lambda pairs: check_shared_repetition(pairs, state.score_rough_pose, limits),
    )
    changed = False
    for check in checks:
        before = list(state.registrations.items())
        after: Iterable[PairRegistration] = check([pair for _, pair in before])
        for (key, old), new in zip(before, after, strict=True):
            if new is not old:
                changed = True
                state.registrations[key] = new
                state.observe(events.VerdictChanged(new))
    return changed
