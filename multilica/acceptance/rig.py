# SPDX-License-Identifier: Apache-2.0
"""Doubt that the rig as a whole casts on accepted and uncertain pairs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from multilica.acceptance.accept import accept, competing_poses
from multilica.acceptance.pair_graph import PairGraph
from multilica.config import AcceptanceConfig
from multilica.geometry import RigidTransform
from multilica.registration.poses import is_distinct, is_near
from multilica.results import PairRegistration, Reason, Registration, Verdict, VisibilityScore, connected
from multilica.results.hypotheses import IMPLIED
from multilica.visibility.sensor_view import ScorePose

_CODE = "cycle_contradicted"
# A smaller turn is no symmetry of a building; halls and garages have those of 90 and 180 degrees.
TURNED_RAD = np.deg2rad(45.0)


def check_scene_symmetry(
    pairs: Sequence[PairRegistration], score_pose: ScorePose, config: AcceptanceConfig
) -> list[PairRegistration]:
    """Leave accepted and uncertain pairs undecided if a symmetry of the scene turns them into another possible pose.

    Two LiDARs that face away from each other see no common surface. In a hall with similar ends they still fit each
    other at a pose turned by 180 degrees, and no beam contradicts it. A pair that sees the whole hall finds two poses.
    The motion between these is the symmetry of the hall, and so is its inverse; each takes the pose of the first two to
    one that may be correct. All LiDARs that pairs join stand in the same hall, also where the pair has none of them.
    A turned pose competes if no beam contradicts it, or if it is nearly as likely. So does a pose that is one
    repetition of the scene away, if the pair has a LiDAR in common with the one that sees it, and no cycle confirms the
    pair.

    Args:
        score_pose: with the tolerances of rough poses.

    Returns:
        The pairs in their order, some with another verdict.
    """
    repeating = [pair for pair in pairs if pair.registrations and competing_poses(pair.registrations, config)]
    return [
        _turned(pair, pairs, repeating, score_pose, config)
        if repeating and may_join(pair) and pair.registrations
        else pair
        for pair in pairs
    ]


def _turned(
    pair: PairRegistration,
    pairs: Sequence[PairRegistration],
    repeating: Sequence[PairRegistration],
    score_pose: ScorePose,
    config: AcceptanceConfig,
) -> PairRegistration:
    pose, margin = pair.T_target_source, config.min_log_odds_margin
    for lidar, other, symmetry in _seen_from(pair, pairs, repeating, config):
        there = symmetry @ pose if lidar == pair.target else pose @ symmetry
        is_turn = pose.distance_to(there)[1] >= TURNED_RAD
        is_own = lidar in other.lidars
        if not is_near(there, config.max_baseline_m) or not is_distinct(there, [pose]) or not (is_turn or is_own):
            continue
        competing = score_pose(there)
        lead = pair.registrations[0].rough_lead_over(competing)
        if is_turn and min(lead, competing.visibility.contradiction) < margin:
            return replace(pair, verdict=Verdict("undecided", (symmetry_reason(pose, competing, other),)))
        if is_own and lead < margin and not _is_confirmed(pair, pairs):
            return replace(pair, verdict=Verdict("undecided", (_repetition(pair, competing, other, lead, config),)))
    return pair


def _seen_from(
    pair: PairRegistration,
    pairs: Sequence[PairRegistration],
    repeating: Sequence[PairRegistration],
    config: AcceptanceConfig,
) -> Iterator[tuple[str, PairRegistration, RigidTransform]]:
    """Yield each motion after which the scene looks the same, in the frame of a LiDAR of the pair.

    Pairs that join LiDARs carry the motions that others see to the pair.

    Yields:
        The LiDAR of the pair, the pair that sees the motion, and the motion.
    """
    names = {name for each in pairs for name in each.lidars}
    graph = PairGraph.of(names, [each for each in pairs if each is not pair and may_join(each)])
    for other in repeating:
        for lidar in sorted(pair.lidars & other.lidars):
            yield from ((lidar, other, motion) for motion in _symmetries(other, lidar, config))
        if pair.lidars & other.lidars:
            continue
        for lidar in sorted(pair.lidars):
            if (there := graph.implied(lidar, other.target)) is not None:
                back = there.inverse()
                motions = _symmetries(other, other.target, config)
                yield from ((lidar, other, there @ motion @ back) for motion in motions)


def _is_confirmed(pair: PairRegistration, pairs: Sequence[PairRegistration]) -> bool:
    return pair.source in connected(pair.target, [each for each in pairs if each is not pair and may_join(each)])


def _symmetries(pair: PairRegistration, lidar: str, config: AcceptanceConfig) -> Iterator[RigidTransform]:
    """Yield motions of the scene, in the frame of a LiDAR of the pair, after which it looks the same to both.

    Two poses without enough evidence are both wrong, so that the motion between them says nothing.
    """
    if not pair.registrations or pair.evidence < config.min_evidence:
        return
    best = pair.T_target_source
    for other in competing_poses(pair.registrations, config):
        there = other.T_target_source
        symmetry = there @ best.inverse() if lidar == pair.target else best.inverse() @ there
        yield symmetry
        yield symmetry.inverse()


def check_cycles(
    pairs: Sequence[PairRegistration], score_pose: ScorePose, config: AcceptanceConfig
) -> list[PairRegistration]:
    """Leave pairs undecided that together put two LiDARs where they cannot both be.

    A chain of accepted pairs implies a pose between its ends. If beams or another accepted pair contradict that pose,
    one pair of the chain is wrong. The evidence of the beams against the implied pose is subtracted from that of each
    pair. In a cycle that does not close, the pair with the least evidence goes, with those that hardly have more. If a
    pair that goes was registered where others implied it, these go as well: it only repeats what they say.

    If a cycle misses by a turn, the scene may look the same from its other end. Wrong pairs then confirm each other, so
    that pairs need twice the lead, also those of other cycles that share a pair with this one.

    Uncertain pairs, which join what accepted ones do not, are in chains and cycles as well. If beams contradict a
    chain, they are doubted before the accepted ones, which were examined without them.

    Returns:
        The pairs in their order, some with another verdict.
    """
    joining = [pair for pair in pairs if may_join(pair) and pair.registrations]
    names = sorted({name for pair in joining for name in pair.lidars})
    graph = PairGraph.of(names, joining)
    doubts: dict[int, Reason] = {}
    for loop in graph.loops:
        implied = graph.implied(loop.target, loop.source)
        if implied is not None and is_distinct(implied, [loop.T_target_source]):
            cycle = graph.cycle(loop)
            needed = min(pair.evidence for pair in cycle) + config.min_log_odds_margin
            if implied.distance_to(loop.T_target_source)[1] >= TURNED_RAD:
                cycle, needed = graph.entangled(cycle), needed + config.min_log_odds_margin
            for pair in cycle:
                if pair.evidence < needed:
                    doubts.setdefault(id(pair), _exclusion(loop, implied))
    _doubt_implying(joining, doubts, config)
    known = {pair.lidars for pair in joining}
    for target, source in combinations(names, 2):
        implied = graph.implied(target, source)
        if implied is None or {target, source} in known:
            continue
        score = score_pose(implied).visibility
        chain = graph.path(target, source)
        uncertain = [pair for pair in chain if not pair.verdict.accepted]
        for pair in uncertain or chain:
            if pair.evidence - score.contradiction < config.min_evidence:
                doubts.setdefault(id(pair), _contradiction(implied, score))
    return _doubted(pairs, doubts)


def _doubt_implying(pairs: Sequence[PairRegistration], doubts: dict[int, Reason], config: AcceptanceConfig) -> None:
    """Doubt the pairs that implied the pose of a doubted one, but for those with clearly more evidence."""
    names = sorted({name for pair in pairs for name in pair.lidars})
    for pair in [each for each in pairs if each.hypothesis == IMPLIED and id(each) in doubts]:
        others = PairGraph.of(names, [each for each in pairs if id(each) not in doubts])
        implied = others.implied(pair.target, pair.source)
        if implied is None or is_distinct(implied, [pair.T_target_source]):
            continue
        for each in others.path(pair.target, pair.source):
            if each.evidence < pair.evidence + config.min_log_odds_margin:
                doubts[id(each)] = doubts[id(pair)]


def check_ambiguous_chains(
    pairs: Sequence[PairRegistration], score_pose: ScorePose, config: AcceptanceConfig
) -> list[PairRegistration]:
    """Leave pairs undecided that imply a pose which an undecided pair with more evidence excludes.

    A pair that can slide, or that a symmetric scene leaves ambiguous, has several poses; the correct one is among
    them, or scores as well. If a chain of accepted pairs implies another one, a pair of the chain fits by chance: the
    one with the least evidence is doubted.

    Returns:
        The pairs in their order, some with another verdict.
    """
    joining = [pair for pair in pairs if may_join(pair) and pair.registrations]
    names = sorted({name for pair in pairs for name in pair.lidars})
    doubts: dict[int, Reason] = {}
    undecided = [pair for pair in pairs if pair.registrations and _is_ambiguous(pair, config)]
    for known in sorted(undecided, key=lambda pair: -pair.evidence):
        while True:
            graph = PairGraph.of(names, [pair for pair in joining if id(pair) not in doubts])
            implied = graph.implied(known.target, known.source)
            if implied is None or _allows(known, implied, score_pose, config):
                break
            chain = graph.path(known.target, known.source)
            weakest = min(chain, key=lambda pair: (pair.verdict.accepted, pair.evidence))
            if weakest.evidence >= known.evidence:
                break
            doubts[id(weakest)] = _exclusion(known, implied)
    return _doubted(pairs, doubts)


def excluded_lidars(
    target: str,
    poses: Mapping[str, RigidTransform],
    pairs: Sequence[PairRegistration],
    score_pose: ScorePose,
    config: AcceptanceConfig,
) -> dict[str, Reason]:
    """Find LiDARs that an undecided pair excludes from where the rig has them.

    A LiDAR that joins a whole group may tell only then that one of the group is turned: against that one, it fits only
    at other poses. Nothing says which of the two is wrong.

    Args:
        target: is never in doubt.
        poses: ``T_target_lidar`` of the placed LiDARs.
    """
    found: dict[str, Reason] = {}
    for pair in pairs:
        if not pair.lidars <= {*poses} or not pair.registrations or not _is_ambiguous(pair, config):
            continue
        implied = poses[pair.target].inverse() @ poses[pair.source]
        if not _allows(pair, implied, score_pose, config):
            for lidar in sorted(pair.lidars - {target}):
                found.setdefault(lidar, _exclusion(pair, implied))
    return found


def check_shared_repetition(
    pairs: Sequence[PairRegistration], score_pose: ScorePose, config: AcceptanceConfig
) -> list[PairRegistration]:
    """Leave pairs undecided that have another possible pose, by what an undecided pair of the same scene found.

    In a car park with equal bays, one pair may find two poses, and another only the wrong one: its search is no proof
    that there is no other. Each pose of the undecided pair implies one for each pair of the chain between its
    ends. Such a pose counts by the evidence of both pairs. Pairs that close a cycle are confirmed by it.

    Args:
        score_pose: with the tolerances of rough poses.

    Returns:
        The pairs in their order, some with another verdict.
    """
    joining = [pair for pair in pairs if may_join(pair) and pair.registrations]
    undecided = [pair for pair in pairs if pair.registrations and _is_ambiguous(pair, config)]
    names = sorted({name for pair in pairs for name in pair.lidars})
    doubts: dict[int, Reason] = {}
    for pair in joining if undecided else ():
        others = PairGraph.of(names, [each for each in joining if each is not pair])
        if others.implied(*sorted(pair.lidars)) is not None:
            continue
        doubt = (_repeated(pair, known, others, score_pose, config) for known in undecided)
        if reason := next(filter(None, doubt), None):
            doubts[id(pair)] = reason
    return _doubted(pairs, doubts)


def _repeated(
    pair: PairRegistration, known: PairRegistration, others: PairGraph, score_pose: ScorePose, config: AcceptanceConfig
) -> Reason | None:
    """Return why another pose of a pair is possible by those of an undecided one; None if none is."""
    pose = pair.T_target_source
    for other in known.registrations[0], *competing_poses(known.registrations, config):
        implied = _through(pair, others, other.T_target_source)
        by_pair = _through(known, others, pose)
        if implied is None or by_pair is None or not is_distinct(implied, [pose]):
            continue
        if not is_near(implied, config.max_baseline_m):
            continue
        competing = score_pose(implied)
        lead = score_pose(pose).rough_lead_over(competing)
        lead += score_pose(by_pair).rough_lead_over(score_pose(other.T_target_source))
        if lead < config.min_log_odds_margin:
            return _repetition(pair, competing, known, lead, config)
    return None


def _through(pair: PairRegistration, others: PairGraph, pose: RigidTransform) -> RigidTransform | None:
    """Return the pose of a pair that a pose between its sides of a graph implies; None if it links other sides."""
    for linking in pose, pose.inverse():
        before = others.implied(pair.target, linking.target)
        after = others.implied(linking.source, pair.source)
        if before is not None and after is not None:
            return before @ linking @ after
    return None


def is_contradicted(pair: PairRegistration) -> bool:
    """Return whether the pair is doubted because it contradicts others."""
    return _CODE in pair.verdict.codes


def may_join(pair: PairRegistration) -> bool:
    """Return whether the pair may join its LiDARs: an uncertain one does where no accepted pair joins them."""
    return pair.verdict.counts


def _doubted(pairs: Sequence[PairRegistration], doubts: Mapping[int, Reason]) -> list[PairRegistration]:
    return [
        replace(pair, verdict=Verdict("undecided", (doubts[id(pair)],))) if id(pair) in doubts else pair
        for pair in pairs
    ]


def _is_ambiguous(pair: PairRegistration, config: AcceptanceConfig) -> bool:
    """Return whether the pair alone is refused only because other poses fit as well."""
    return pair.verdict.outcome == "undecided" and accept(pair.registrations, config).outcome == "undecided"


def _allows(pair: PairRegistration, implied: RigidTransform, score_pose: ScorePose, config: AcceptanceConfig) -> bool:
    """Return whether the implied pose is one of the pair's own, or scores as well."""
    best, *_ = pair.registrations
    own = [each.T_target_source for each in (best, *competing_poses(pair.registrations, config))]
    return not is_distinct(implied, own) or best.rough_lead_over(score_pose(implied)) < config.min_log_odds_margin


def symmetry_reason(pose: RigidTransform, competing: Registration, seen_by: PairRegistration) -> Reason:
    """Return the reason to doubt a pose in a scene that looks the same when turned."""
    metres, radians = pose.distance_to(competing.T_target_source)
    text = (
        f"{seen_by.target} and {seen_by.source} see a scene that looks the same when turned by "
        f"{np.rad2deg(radians):.0f} deg, so another pose {metres:.2f} m away is also possible"
    )
    return Reason("ambiguous", 1.0, 0.0, text, competing)


def _repetition(
    pair: PairRegistration, competing: Registration, seen_by: PairRegistration, lead: float, config: AcceptanceConfig
) -> Reason:
    metres, radians = pair.T_target_source.distance_to(competing.T_target_source)
    text = (
        f"{seen_by.target} and {seen_by.source} fit at several poses, and one of these puts {pair.source} "
        f"{metres:.2f} m and {np.rad2deg(radians):.0f} deg away, where it fits nearly as well (lead {lead:.1f}, "
        f"needs {config.min_log_odds_margin:g})"
    )
    return Reason("ambiguous", lead, config.min_log_odds_margin, text, competing)


def _exclusion(pair: PairRegistration, implied: RigidTransform) -> Reason:
    metres, radians = pair.T_target_source.distance_to(implied)
    text = (
        f"with other accepted pairs it puts {implied.source} {metres:.2f} m and {np.rad2deg(radians):.0f} deg from "
        f"where {implied.source} fits {implied.target}, so one of the pairs is wrong"
    )
    return Reason(_CODE, metres, 0.0, text)


def _contradiction(implied: RigidTransform, score: VisibilityScore) -> Reason:
    share = score.violation_share
    text = (
        f"with other accepted pairs it puts {implied.source} where {share:.1%} of the points shared with "
        f"{implied.target} lie in proven-empty space, so one of the pairs is wrong"
    )
    return Reason(_CODE, share, 0.0, text)
