# SPDX-License-Identifier: Apache-2.0
"""Accepted pairs that put a LiDAR where it cannot be twice."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

from multilica.explanation.comparisons import Document
from multilica.geometry import RigidTransform

__all__ = ["TwoPlaces", "two_places"]

_DISTINCT_M = 0.3
_DISTINCT_RAD = math.radians(3.0)


@dataclass(frozen=True, slots=True, eq=False)
class TwoPlaces:
    """Two pairs, each accepted by itself, and how far apart they put the LiDAR that they share.

    Args:
        believed, other: the documents of the pairs, the one with more evidence first.
    """

    believed: Document
    other: Document
    distance_m: float
    angle_rad: float

    @property
    def sentence(self) -> str:
        """Both pairs with their fitness, and the distance."""
        pairs = (
            f"{one['source']} against {one['target']} ({one['fitness']:.2f})" for one in (self.believed, self.other)
        )
        apart = f"{self.distance_m:.2f} m and {math.degrees(self.angle_rad):.0f} deg apart"
        return f"{' and '.join(pairs)} are each accepted by themselves, and put it at places {apart}."


def two_places(document: Document, lidar: str, pairs: Sequence[Document]) -> TwoPlaces | None:
    """The two places that are farthest from each other; None where all pairs agree.

    Args:
        lidar: one that is not placed.
        pairs: those that could have placed it, the most believable first.
    """
    accepted = [pair for pair in pairs if pair["verdict"]["outcome"] == "accept"]
    placed = [(pair, pose) for pair in accepted if (pose := _place(document, lidar, pair)) is not None]
    found = [(first, second, *here.distance_to(there)) for (first, here), (second, there) in combinations(placed, 2)]
    apart = [TwoPlaces(*each) for each in found if each[2] > _DISTINCT_M or each[3] > _DISTINCT_RAD]
    return max(apart, key=lambda each: (each.distance_m, each.angle_rad), default=None)


def _place(document: Document, lidar: str, pair: Document) -> RigidTransform | None:
    """``T_target_lidar`` by that pair; None where its other LiDAR is not placed."""
    fixed = pair["source"] if pair["target"] == lidar else pair["target"]
    entry = document["lidars"][fixed]
    if not entry["placed"] or lidar not in (pair["target"], pair["source"]):
        return None
    pose = _pose(pair["target"], pair["source"], pair)
    return _pose(document["target"], fixed, entry) @ (pose if pair["target"] == fixed else pose.inverse())


def _pose(target: str, source: str, entry: Document) -> RigidTransform:
    return RigidTransform.from_xyz_quaternion(target, source, entry["xyz_m"], entry["quaternion_xyzw"])
