# SPDX-License-Identifier: Apache-2.0
"""Which LiDAR is the root of a joint result."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from multilica.errors import UnknownNameError
from multilica.joint.disputes import Edges
from multilica.results import PairRegistration

__all__ = ["choose_target"]


def choose_target(edges: Edges, lidars: Sequence[str], asked_for: str) -> tuple[str, str]:
    """The LiDAR asked for, else the one with the most overlap in the most snapshots; with the reason.

    Args:
        edges: of at least one snapshot, without what contradicts others: else the target could be what they contradict.
        lidars: names of all, in order.
        asked_for: empty if none is.

    Raises:
        UnknownNameError: no snapshot has the LiDAR asked for.
    """
    if asked_for:
        if asked_for not in lidars:
            raise UnknownNameError("LiDAR", asked_for, lidars)
        return asked_for, "as asked for"
    overlaps = [_overlap(own) for own in edges.values()]
    first = Counter(max(sorted(overlap), key=lambda name: overlap[name]) for overlap in overlaps if overlap)
    total = sum(overlaps, Counter[str]())
    best = max(lidars, key=lambda name: (first[name], total[name]))
    return best, f"the LiDAR with the most overlap in {first[best]} of {len(edges)} snapshots"


def _overlap(edges: Sequence[PairRegistration]) -> Counter[str]:
    overlap: Counter[str] = Counter()
    for edge in edges:
        for name in (edge.target, edge.source):
            overlap[name] += edge.fitness  # type: ignore[assignment]
    return overlap
