# SPDX-License-Identifier: Apache-2.0
"""Choice of the pairs of LiDARs to search next, of those that other pairs imply, and of the target."""

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import combinations, permutations

from multilica.acceptance.pair_graph import PairGraph
from multilica.geometry import RigidTransform
from multilica.registration.poses import is_distinct
from multilica.results import PairKey, PairRegistration, PreprocessedCloud, Registration

LEAST_PRIORITY = 6.0
"""Matches that agree by chance in clouds without anything in common; below, one search of ten finds a pose."""

# The noise of a LiDAR's scan is the same in all its pairs, so more loops hardly improve its pose.
_LOOPS_PER_LIDAR = 4


def components(names: Iterable[str], pairs: Iterable[PairKey]) -> dict[str, str]:
    """Return per name the first name of the group that the pairs connect it to."""
    first = {name: name for name in names}
    for one, other in pairs:
        kept, gone = sorted((first[one], first[other]))
        first = {name: kept if group == gone else group for name, group in first.items()}
    return first


def next_round(
    names: Sequence[str],
    accepted: Iterable[PairKey],
    tried: Collection[PairKey],
    priority: Mapping[PairKey, float],
) -> list[PairKey]:
    """Choose the pairs to search next: of each group that accepted pairs connect, the most promising way out of it.

    This is Boruvka's algorithm for a spanning tree: rigs with much overlap need few searches more than they have
    LiDARs, and the pairs of a round do not depend on each other.

    Args:
        tried: pairs that were searched before.
        priority: of each pair; the larger, the sooner it is searched.

    Returns:
        In the order of the priority; empty if all LiDARs are connected or nothing is left to try.
    """
    group = components(names, accepted)
    chosen: dict[str, PairKey] = {}
    ranked = sorted(priority, key=lambda pair: (-priority[pair], pair))
    for pair in ranked:
        groups = {group[name] for name in pair}
        if pair in tried or len(groups) == 1:
            continue
        for each in groups:
            chosen.setdefault(each, pair)
    return [pair for pair in ranked if pair in chosen.values()]


def pairs_by_role(names: Sequence[str], target: str, mode: str) -> list[PairKey]:
    """List the pairs that a search without verification needs, each with the roles of `merge.mode`.

    With `target_first` every LiDAR is the source of the target. With `algorithm1` each pair is searched in both
    directions, which differ in their fitness and often in their pose. With `graph` each is searched once.
    """
    if mode == "target_first":
        return [(target, name) for name in names if name != target]
    return list(permutations(names, 2) if mode == "algorithm1" else combinations(names, 2))


def implied_poses(
    names: Iterable[str], pairs: Iterable[PairKey], accepted: Sequence[PairRegistration]
) -> dict[PairKey, RigidTransform]:
    """Return the pose of each pair that accepted pairs link without having registered it."""
    graph = PairGraph.of(names, accepted)
    known = {pair.lidars for pair in accepted}
    poses = {pair: graph.implied(*pair) for pair in pairs if frozenset(pair) not in known}
    return {pair: pose for pair, pose in poses.items() if pose is not None}


def is_open(before: PairRegistration | None, implied: RigidTransform) -> bool:
    """Return whether registering the implied pose may add a pair.

    It adds nothing where the registration ended there before, and was not accepted only because the scene does not
    constrain it well.
    """
    if before is None:
        return True
    ended_there = not is_distinct(implied, [before.T_target_source.with_target(implied.target)])
    return not before.verdict.accepted and not (
        ended_there and before.verdict.codes in (("not_observable",), ("imprecise",), ("sigma_unknown",))
    )


def choose_loops(
    scores: Mapping[PairKey, Registration], min_evidence: float, most: int = _LOOPS_PER_LIDAR
) -> list[PairKey]:
    """Choose the pairs with common surfaces that are registered, the ones with the most evidence first.

    No LiDAR is in more than a few of them.
    """
    count: Counter[str] = Counter()
    chosen: list[PairKey] = []
    for pair in sorted(scores, key=lambda pair: (-scores[pair].evidence, pair)):
        if scores[pair].evidence >= min_evidence and max(count[name] for name in pair) < most:
            count.update(pair)
            chosen.append(pair)
    return chosen


def choose_target(
    asked_for: str, clouds: Mapping[str, PreprocessedCloud], pairs: Sequence[PairRegistration]
) -> tuple[str, str]:
    """Choose the root of the result: the LiDAR that the user asks for, if any, else the one with the most overlap.

    Uncertain pairs count where no pair is accepted: they join LiDARs as well.

    Returns:
        The name of the target and the reason in words.
    """
    if asked_for:
        return asked_for, "set by --target"
    joining = [pair for pair in pairs if pair.verdict.accepted]
    joining = joining or [pair for pair in pairs if pair.verdict.outcome == "uncertain"]
    overlap = dict.fromkeys(clouds, 0.0)
    for pair in joining:
        overlap[pair.target] += pair.fitness
        overlap[pair.source] += pair.fitness
    best = max(overlap, key=lambda name: (overlap[name], len(clouds[name].points_m)))
    if not joining:
        return best, "most points, as no pair was accepted"
    return best, f"most overlap, the fitness of its pairs adds up to {overlap[best]:.2f}"
