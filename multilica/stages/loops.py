# SPDX-License-Identifier: Apache-2.0
"""Pairs of LiDARs that accepted pairs link: their poses follow, and beams and registration test them."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from multilica.acceptance.pair_graph import PairGraph
from multilica.geometry import RigidTransform
from multilica.registration.poses import is_distinct
from multilica.results import PairKey, PairRegistration, Registration

# The noise of a LiDAR's scan is the same in all its pairs, so more loops hardly improve its pose.
_LOOPS_PER_LIDAR = 4


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
        ended_there and before.verdict.codes in (("not_observable",), ("imprecise",))
    )


def choose_loops(scores: Mapping[PairKey, Registration], min_evidence: float) -> list[PairKey]:
    """Choose the pairs with common surfaces that are registered, the ones with the most evidence first.

    No LiDAR is in more than a few of them.
    """
    count: Counter[str] = Counter()
    chosen: list[PairKey] = []
    for pair in sorted(scores, key=lambda pair: (-scores[pair].evidence, pair)):
        if scores[pair].evidence >= min_evidence and max(count[name] for name in pair) < _LOOPS_PER_LIDAR:
            count.update(pair)
            chosen.append(pair)
    return chosen
