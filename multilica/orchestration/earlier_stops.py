# SPDX-License-Identifier: Apache-2.0
"""Earlier stops of a drive, which tell where a search is needed at the next one."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

from multilica.acceptance.pair_graph import PairGraph
from multilica.geometry import RigidTransform
from multilica.results import CalibrationResult, PairKey


@dataclass(frozen=True, slots=True)
class EarlierStops:
    """Poses of pairs that earlier stops found, and pairs that they searched in vain.

    The LiDARs are where they were, so those poses are tested by the beams before anything is searched. Two LiDARs
    without a common view at one stop have none at the next: they are searched once more, with the usual descriptors, if
    more of their matches agree than by chance.

    Args:
        poses: by pair, in name order.
        vain: pairs that all descriptors were tried for.
    """

    poses: Mapping[PairKey, RigidTransform] = field(default_factory=dict)
    vain: Collection[PairKey] = ()

    @classmethod
    def of(cls, results: Sequence[CalibrationResult]) -> "EarlierStops":
        """Collect what the first results tell; the first pose of a pair counts."""
        poses: dict[PairKey, RigidTransform] = {}
        vain: set[PairKey] = set()
        for result in results:
            names = sorted(each.lidar for each in result.placements)
            graph = PairGraph.of(names, [pair for pair in result.trusted if pair.verdict.accepted])
            for pair in combinations(names, 2):
                pose = graph.implied(*pair)
                if pose is not None:
                    poses.setdefault(pair, pose)
            if result.time_limit is None:
                rejected = [pair.lidars for pair in result.pairs if pair.verdict.outcome == "reject"]
                vain |= {pair for pair in combinations(names, 2) if frozenset(pair) in rejected}
        return cls(poses, frozenset(vain - poses.keys()))
