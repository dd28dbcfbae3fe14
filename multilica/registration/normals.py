# SPDX-License-Identifier: Apache-2.0
"""Normals and flatness of a cloud's points."""

import numpy as np

from multilica.geometry import FloatArray
from multilica.registration.neighbours import PointTree, principal_directions
from multilica.results import IndexArray

__all__ = ["Surface"]

_TINY = 1e-12


class Surface:
    """Planes through the points of a cloud, each estimated on first use.

    Args:
        tree: of the cloud's points.
        neighbours: number of points, itself included, that the plane of each is fitted to.
    """

    def __init__(self, tree: PointTree, neighbours: int) -> None:
        count = len(tree.points_m)
        self.tree = tree
        self._neighbours = neighbours
        self._known = np.zeros(count, dtype=bool)
        self._normals = np.empty((count, 3))
        self._flatness = np.empty(count)

    def at(self, index: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Return unit normals (M, 3) of either sign and flatness (M,) of the points at these (M,) indices.

        Flatness goes from 0 (a twig, a single scan line, a bush) to 1 (a plane). It is 1 - s0 / s1 of the standard
        deviations s0 <= s1 <= s2 along the principal directions: along a line s1 is as small as s0, in a bush all
        three are alike.
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
