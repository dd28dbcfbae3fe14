# SPDX-License-Identifier: Apache-2.0
"""The surface that each point of a cloud lies on, as its neighbours tell it."""

from __future__ import annotations

import numpy as np

from multilica.geometry import FloatArray
from multilica.results import IndexArray
from multilica.stages.point_tree import PointTree, principal_directions

__all__ = ["Surface"]

_TINY = 1e-12


class Surface:
    """Planes through the points of a cloud, each found when it is first asked for.

    Args:
        tree: of the cloud's points.
        neighbours: how many points, itself included, tell the plane of each.
    """

    def __init__(self, tree: PointTree, neighbours: int) -> None:
        count = len(tree.points_m)
        self.tree = tree
        self._neighbours = neighbours
        self._known = np.zeros(count, dtype=bool)
        self._normals = np.empty((count, 3))
        self._flatness = np.empty(count)

    def at(self, index: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Of the points at these (M,) indices: (M, 3) unit normals of either sign, and (M,) flatness.

        Flatness goes from 0, where the neighbours have no plane (a twig, a single scan line, a bush), to 1. It is
        1 - s0 / s1 of the standard deviations s0 <= s1 <= s2 along their principal directions: along a line s1 is as
        small as s0, and any normal across it is as good as another; in a bush all three are alike.
        """
        known = self._known[index]
        if not np.all(known):
            unknown = np.unique(index[~known])
            self._normals[unknown], self._flatness[unknown] = self._estimated(unknown)
            self._known[unknown] = True
        return self._normals[index], self._flatness[index]

    def _estimated(self, index: IndexArray) -> tuple[FloatArray, FloatArray]:
        points_m = self.tree.points_m
        neighbours = self.tree.neighbours(points_m[index], self._neighbours)
        variances, directions = principal_directions(points_m, neighbours)
        deviations = np.sqrt(np.maximum(variances, 0.0))
        flatness = 1.0 - deviations[:, 0] / np.maximum(deviations[:, 1], _TINY)
        return directions[:, :, 0], np.maximum(flatness, 0.0)
