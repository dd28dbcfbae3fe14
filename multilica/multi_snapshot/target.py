# SPDX-License-Identifier: Apache-2.0
"""Choice of the target LiDAR of a joint result."""

from collections import Counter, defaultdict
from collections.abc import Sequence
from math import fsum

from multilica.errors import UnknownNameError
from multilica.multi_snapshot.disputes import SnapshotPairs
from multilica.results import PairRegistration

__all__ = ["choose_target"]


def choose_target(pairs: SnapshotPairs, lidars: Sequence[str], asked_for: str) -> tuple[str, str]:
    """Choose the LiDAR that the user names, else the one with the most overlap in the most snapshots.

    Args:
        pairs: of at least one snapshot, without contradicting ones, so that the target is not disputed.
        lidars: all names, in order.
        asked_for: empty if the user names none.

    Returns:
        The name of the target and the reason in words.

    Raises:
        UnknownNameError: no snapshot has the LiDAR that the user names.
    """
    if asked_for:
        if asked_for not in lidars:
            raise UnknownNameError("LiDAR", asked_for, lidars)
        return asked_for, "set by --target"
    overlaps = [_overlap(own) for own in pairs.values()]
    first = Counter(max(sorted(overlap), key=overlap.__getitem__) for overlap in overlaps if overlap)
    total = {name: fsum(overlap.get(name, 0.0) for overlap in overlaps) for name in lidars}
    best = max(lidars, key=lambda name: (first[name], total[name]))
    return best, f"most overlap in {first[best]} of {len(pairs)} snapshots"


def _overlap(pairs: Sequence[PairRegistration]) -> dict[str, float]:
    """Sum the fitness of each LiDAR's pairs; equal sums are equal in any order of the pairs."""
    fitness: defaultdict[str, list[float]] = defaultdict(list)
    for pair in pairs:
        for name in (pair.target, pair.source):
            fitness[name].append(pair.fitness)
    return {name: fsum(values) for name, values in fitness.items()}
