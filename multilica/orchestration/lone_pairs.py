# SPDX-License-Identifier: Apache-2.0
"""Pairs that alone, or with few others, join two groups, tested with all that these groups see."""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from math import log

import numpy as np

from multilica import events
from multilica.acceptance.accept import is_in_long_place, may_compete
from multilica.acceptance.pair_graph import PairGraph
from multilica.acceptance.rig import TURNED_RAD, is_contradicted, may_join, symmetry_reason
from multilica.config import AcceptanceConfig
from multilica.geometry import RigidTransform
from multilica.orchestration.pairs import register_sides
from multilica.orchestration.state import CalibrationState
from multilica.registration.poses import is_distinct, is_near
from multilica.results import Group, Hypothesis, PairKey, PairRegistration, Reason, Registration, Verdict, connected
from multilica.results.hypotheses import IMPLIED
from multilica.stages.fine import leads_surely

# Groups are registered at so many further poses of a pair, the likeliest ones; six LiDARs take some seconds.
_MOST_ELSEWHERE = 2
# A wrong pose in a tunnel may fit at any of 15 places a metre apart: LiDARs of one vehicle are within 15 m.
_OF_LONG_PLACE = log(15.0)
# With a third of the LiDARs not searched, one of three could still contradict the other two.
_MISSED_SHARE = 1.0 / 3.0


def doubt_lone_pairs(state: CalibrationState) -> None:
    """Leave pairs undecided that join two groups with little evidence, or alone where these groups fit elsewhere too.

    If a search found several poses with enough evidence, all but one are wrong: here a wrong pose may have enough. The
    pairs that join two groups then need together as much as if another pose competed. In a tunnel, where a wrong pose
    may be anywhere along it, they need a part of that.

    A pair decides by what two LiDARs see, and their groups see more: a lone pair is also tested at the other poses that
    searches between its groups found, and at those that both groups and a third LiDAR imply. If the time is over, it is
    in doubt until most LiDARs were compared with one of theirs.

    If two groups fit turned as well, the scene looks the same from its other end, and a lone pair that shares a LiDAR
    with the pair of these is in doubt unless beams contradict its turned pose.

    Pairs that were registered where others imply them repeat what these say: between equal trees, four of them agreed
    with a wrong pair. They go with it.
    """
    settled: dict[PairKey, tuple[Reason, ...]] = {}
    turns: list[_Turn] = []
    while joint := next(_doubtful_joints(state, settled, turns), None):
        _doubt_joint(state, *joint)


def doubt_merge(
    state: CalibrationState, merge: PairRegistration, groups: tuple[Group, Group], between: Sequence[PairRegistration]
) -> PairRegistration:
    """Leave two groups undecided that no pair joins, if one of their pairs or a scene that may repeat casts doubt.

    A pair at another pose with more evidence than the merge does so, even if other pairs contradict it. In a scene that
    may repeat, groups need more evidence. They need a margin more if one of their pairs has another possible pose:
    wrong merges had an evidence of 9.

    Args:
        groups: of the merge's target and source.
        between: the registrations of their members.
    """
    if not may_join(merge) or any(may_join(pair) for pair in between):
        return merge
    joins = f"no pair joins the groups of {merge.target} and {merge.source}"
    against = next((pair for pair in between if is_contradicted(pair) and _is_stronger(pair, merge, groups)), None)
    if against is not None:
        return replace(merge, verdict=Verdict("undecided", (_stronger_pair(joins, merge, against),)))
    limits = state.config.acceptance
    ambiguous = any("ambiguous" in pair.verdict.codes for pair in between)
    least = limits.min_evidence + (2.0 if ambiguous else 1.0) * limits.min_log_odds_margin
    if merge.evidence >= least or not (ambiguous or _scene_repeats(state)):
        return merge
    return replace(merge, verdict=Verdict("undecided", (_may_repeat(joins, merge.evidence, least),)))


def _is_stronger(pair: PairRegistration, merge: PairRegistration, groups: tuple[Group, Group]) -> bool:
    """Return whether a pair puts two groups elsewhere than their merge, with more evidence."""
    target, source = groups
    there = target.pose_of(source, pair.T_target_source)
    return pair.evidence > merge.evidence and is_distinct(there, [merge.T_target_source])


def _stronger_pair(joins: str, merge: PairRegistration, pair: PairRegistration) -> Reason:
    text = (
        f"{joins}, and {pair.source} fits {pair.target} better at another pose (evidence {pair.evidence:.1f} against "
        f"{merge.evidence:.1f}), though other pairs contradict that"
    )
    return Reason("ambiguous", merge.evidence - pair.evidence, 0.0, text)


_Turn = tuple[str, RigidTransform, PairRegistration]
"""A LiDAR, a turn after which the scene looks the same, in its frame, and the pair whose groups see that."""

_Joint = tuple[Sequence[PairRegistration], set[str], set[str]]
"""The pairs that join two groups, and the LiDARs of both."""


def _doubtful_joints(
    state: CalibrationState, settled: dict[PairKey, tuple[Reason, ...]], turns: list[_Turn]
) -> Iterator[tuple[_Joint, tuple[Reason, ...]]]:
    """Yield the pairs that join two groups and are in doubt, with the reasons; the weakest first.

    Args:
        settled: the lone pairs whose groups were registered, which takes long, with what was found.
        turns: receives the turns after which the scene looks the same to such groups, in the frame of a LiDAR.
    """
    joining = [pair for pair in state.registrations.values() if may_join(pair)]
    searched = [pair for pair in joining if pair.hypothesis != IMPLIED and pair.registrations]
    repeats = _scene_repeats(state)
    tree = PairGraph.of(sorted(state.clouds), searched).tree
    for pair in reversed(tree):
        others = [each for each in tree if each is not pair]
        members, of_source = connected(pair.target, others), connected(pair.source, others)
        across = [each for each in searched if each.lidars & members and each.lidars & of_source]
        doubt = _not_compared(state, across, members | of_source)
        doubt = doubt or _little_evidence(pair, across, repeats, state.config.acceptance)
        if not doubt and (len(across) == 1 or _search_repeats(state, members, of_source)):
            key = pair.target, pair.source
            if key not in settled:
                settled[key] = _competing(state, pair, others, turns)
            doubt = settled[key] or _turned(state, pair, turns)
        if doubt:
            yield (across, members, of_source), doubt


def _not_compared(
    state: CalibrationState, across: Sequence[PairRegistration], joined: Collection[str]
) -> tuple[Reason, ...]:
    """Return why a lone pair is in doubt that LiDARs could contradict which there was no time to search; else nothing.

    In a symmetric hall, a turned pair is refused only when a third LiDAR was searched that sees more of it. Most LiDARs
    are enough: a scene that repeats does so for many of them.
    """
    if len(across) > 1 or not state.cut_short:
        return ()
    compared = {name for pair in (*state.coarse, *state.registrations) if {*pair} & {*joined} for name in pair}
    missed = sorted({*state.clouds} - compared)
    if len(missed) < _MISSED_SHARE * len(state.clouds):
        return ()
    pair = across[0]
    text = (
        f"the time limit (--max-time) ended the search before {', '.join(missed)} could contradict {pair.source} "
        f"against {pair.target}, which alone joins their groups"
    )
    return (Reason("out_of_time", len(missed), 0.0, text),)


def _search_repeats(state: CalibrationState, members: set[str], others: set[str]) -> bool:
    """Return whether a search between two groups left open at which of several repeated places they are."""
    return any(
        pair.lidars & members and pair.lidars & others and "held_by_repetition" in pair.verdict.codes
        for pair in state.searched.values()
    )


def _scene_repeats(state: CalibrationState) -> bool:
    """Return whether the search of a pair found several poses with enough evidence: all but one are wrong."""
    found = (*state.registrations.values(), *state.searched.values())
    return any(_places(pair, state.config.acceptance) > 1 for pair in found)


def _doubt_joint(state: CalibrationState, joint: _Joint, doubt: tuple[Reason, ...]) -> None:
    """Leave pairs undecided that join two groups, and all that were registered where these implied them."""
    across, members, of_source = joint
    gone = {pair.lidars for pair in across}
    for key, each in list(state.registrations.items()):
        joins = each.lidars & members and each.lidars & of_source
        repeats = each.hypothesis == IMPLIED and not gone.isdisjoint(state.implied_by.get(key, ()))
        if may_join(each) and (joins or repeats):
            _doubt(state, key, doubt)


def _places(pair: PairRegistration, config: AcceptanceConfig) -> int:
    """Return the number of poses of the pair that would count by themselves."""
    return sum(each.evidence >= config.min_evidence for each in pair.registrations)


def _little_evidence(
    pair: PairRegistration, across: Sequence[PairRegistration], repeats: bool, limits: AcceptanceConfig
) -> tuple[Reason, ...]:
    """Return why the pairs that join two groups have too little evidence where wrong poses have some; else nothing."""
    evidence = sum(each.evidence for each in across)
    is_long = all(is_in_long_place(each.registrations[0].visibility) for each in across)
    least = limits.min_evidence + (limits.min_log_odds_margin if repeats else _OF_LONG_PLACE if is_long else 0.0)
    if evidence >= least:
        return ()
    joins = f"only {pair.source} against {pair.target} joins their groups"
    if len(across) > 1:
        joins = f"only {len(across)} pairs, as {pair.source} against {pair.target}, join their groups"
    return (_may_repeat(joins, evidence, least),)


def _may_repeat(joins: str, evidence: float, least: float) -> Reason:
    text = f"{joins}, and the scene may repeat (evidence {evidence:.1f}, needs {least:.1f})"
    return Reason("held_by_repetition", evidence, least, text)


def _elsewhere(pair: PairRegistration, pose: RigidTransform, evidence: float) -> Reason:
    metres, radians = pair.T_target_source.distance_to(pose)
    text = (
        f"the groups that {pair.source} against {pair.target} joins fit better {metres:.2f} m and "
        f"{np.rad2deg(radians):.0f} deg away (evidence {evidence:.1f} against {pair.evidence:.1f})"
    )
    return Reason("ambiguous", pair.evidence - evidence, 0.0, text)


def _turned(state: CalibrationState, pair: PairRegistration, turns: Sequence[_Turn]) -> tuple[Reason, ...]:
    """Return why a lone pair of LiDARs in a scene that looks the same when turned is in doubt; nothing if it is not.

    LiDARs that look apart fit each other turned as well, and nothing but the turn that others see tells of the pose
    that is true.
    """
    pose, limits = pair.T_target_source, state.config.acceptance
    known = state.score_rough_pose(pose)
    for lidar, turn, seen_by in turns:
        if lidar not in pair.lidars:
            continue
        there = turn @ pose if lidar == pair.target else pose @ turn
        if not is_near(there, limits.max_baseline_m) or not is_distinct(there, [pose]):
            continue
        competing = state.score_rough_pose(there)
        if min(known.rough_lead_over(competing), competing.visibility.contradiction) < limits.min_log_odds_margin:
            return (symmetry_reason(pose, competing, seen_by),)
    return ()


def _competing(
    state: CalibrationState,
    pair: PairRegistration,
    others: Sequence[PairRegistration],
    turns: list[_Turn],
) -> tuple[Reason, ...]:
    """Return why the groups that a pair joins fit as well at another pose; nothing if they do not."""
    graph = PairGraph.of(sorted(state.clouds), others)
    further = _found_elsewhere(state, pair, graph)
    sees_more = len(graph.poses(pair.target)) + len(graph.poses(pair.source)) > 2
    if not further and not (sees_more and _places(pair, state.config.acceptance) > 1):
        return ()
    target, source = (state.side_of(root, graph.poses(root)) for root in (pair.target, pair.source))
    starts = [Hypothesis(pose) for pose in (pair.T_target_source, *further)]
    if leads_surely(target, source, starts, state.config):
        return ()
    found = register_sides(target, source, starts, state.config)
    pose = found.T_target_source.with_target(pair.target)
    if is_distinct(pose, [pair.T_target_source]):
        return (_elsewhere(pair, pose, found.evidence),)
    competing = [reason for reason in found.verdict.reasons if reason.competing is not None]
    for there in (each.competing.T_target_source for each in competing if each.competing is not None):
        turned = there.with_target(pair.target)
        if pose.distance_to(turned)[1] >= TURNED_RAD:
            of_target, of_source = turned @ pose.inverse(), pose.inverse() @ turned
            turns.extend((pair.target, turn, pair) for turn in (of_target, of_target.inverse()))
            turns.extend((pair.source, turn, pair) for turn in (of_source, of_source.inverse()))
    return tuple(replace(reason, competing=None) for reason in competing)


def _found_elsewhere(state: CalibrationState, pair: PairRegistration, graph: PairGraph) -> list[RigidTransform]:
    """Return poses of a pair that may compete with it: searches between its groups, or to a third LiDAR, found them."""
    limits, known = state.config.acceptance, state.score_rough_pose(pair.T_target_source)
    found: list[RigidTransform] = []
    for pose in _implied(state, graph.poses(pair.target), graph.poses(pair.source)):
        is_new = is_near(pose, limits.max_baseline_m) and is_distinct(pose, [pair.T_target_source, *found])
        if is_new and may_compete(known, state.score_rough_pose(pose), limits):
            found.append(pose)
    return sorted(found, key=lambda pose: known.rough_lead_over(state.score_rough_pose(pose)))[:_MOST_ELSEWHERE]


def _implied(
    state: CalibrationState, targets: Mapping[str, RigidTransform], sources: Mapping[str, RigidTransform]
) -> Iterator[RigidTransform]:
    """Yield the poses between the roots of two groups that searches between them, or of both to a third LiDAR, imply.

    A search of two LiDARs has compared its own poses, so two groups of one have no others between them.

    Args:
        targets, sources: the pose of each member in the root of its group.
    """
    if len(targets) + len(sources) > 2:
        for (target, T_root), (source, T_other) in product(sorted(targets.items()), sorted(sources.items())):
            for pose in _verified_poses(state, target, source):
                yield T_root @ pose @ T_other.inverse()
    for lidar in sorted({*state.clouds} - {*targets, *sources}):
        before = [T_root @ each for name, T_root in sorted(targets.items()) for each in _poses(state, name, lidar)]
        after = [T_root @ each for name, T_root in sorted(sources.items()) for each in _poses(state, name, lidar)]
        for to_target, to_source in product(before, after):
            yield to_target @ to_source.inverse()


def _poses(state: CalibrationState, target: str, source: str) -> Iterable[RigidTransform]:
    """Yield the poses between two LiDARs that a search found and that would count by themselves."""
    for pair in (state.searched.get((target, source)), state.searched.get((source, target))):
        yield from _that_count(state, target, () if pair is None else pair.registrations)


def _verified_poses(state: CalibrationState, target: str, source: str) -> Iterable[RigidTransform]:
    """Yield the same, with those that the search did not register to the end."""
    for pair in ((target, source), (source, target)):
        yield from _that_count(state, target, state.verified.get(pair, ()))


def _that_count(state: CalibrationState, target: str, found: Sequence[Registration]) -> Iterator[RigidTransform]:
    least = state.config.acceptance.min_evidence
    return (each.T_target_source.with_target(target) for each in found if each.evidence >= least)


def _doubt(state: CalibrationState, key: PairKey, reasons: tuple[Reason, ...]) -> None:
    pair: PairRegistration = replace(state.registrations[key], verdict=Verdict("undecided", reasons))
    state.registrations[key] = pair
    state.observe(events.VerdictChanged(pair))
