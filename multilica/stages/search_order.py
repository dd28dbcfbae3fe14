# SPDX-License-Identifier: Apache-2.0
"""Order in which pairs of LiDARs are searched."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import combinations, permutations

from multilica.results import PairKey


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
