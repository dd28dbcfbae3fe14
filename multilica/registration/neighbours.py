# SPDX-License-Identifier: Apache-2.0
"""Neighbourhoods of points: nearest neighbours, planes, voxels."""

import numpy as np
import small_gicp

from multilica.geometry import FloatArray
from multilica.results import IndexArray

__all__ = ["PointTree", "Surface", "principal_directions", "thin"]


class PointTree:
    """A k-d tree for unbounded searches, twice as fast as SciPy's; SciPy's is faster for bounded ones.

    Args:
        points_m: (N, 3).
        threads: for building and searching it.

    Attributes:
        cloud, engine: the same points and tree as the types of small_gicp.
    """

    def __init__(self, points_m: FloatArray, threads: int = 1) -> None:
        self.threads = threads
        self.points_m = np.ascontiguousarray(points_m)
        self.cloud = small_gicp.PointCloud(self.points_m)
        self.engine = small_gicp.KdTree(self.cloud, num_threads=threads)

    def nearest(self, points_m: FloatArray) -> tuple[FloatArray, IndexArray]:
        """Return distance (M,) and index (M,) of the nearest neighbour of each of (M, 3) points."""
        index, squared_m2 = self.engine.batch_knn_search(points_m, 1, self.threads)
        return np.sqrt(squared_m2[:, 0]), index[:, 0].astype(np.int64)

    def neighbours(self, points_m: FloatArray, count: int) -> IndexArray:
        """Return the indices (M, count) of the nearest neighbours of (M, 3) points; fewer if there are fewer."""
        index, _ = self.engine.batch_knn_search(points_m, min(count, len(self.points_m)), self.threads)
        return np.asarray(index.astype(np.int64))


def principal_directions(points_m: FloatArray, neighbours: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Compute how the neighbours of M points spread about their mean.

    Args:
        points_m: (N, 3).
        neighbours: (M, K) indices.

    Returns:
        (M, 3) sums of squares along the principal directions, the smallest first, and (M, 3, 3) these directions as
        columns.
    """
    around = [coordinate[neighbours] for coordinate in np.ascontiguousarray(points_m.T)]
    centred = [each - each.mean(axis=1, keepdims=True) for each in around]
    scatter = np.empty((len(neighbours), 3, 3))
    for row, column in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        scatter[:, row, column] = scatter[:, column, row] = np.einsum("ij,ij->i", centred[row], centred[column])
    variances, directions = np.linalg.eigh(scatter)
    return variances, directions


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
        flatness = 1.0 - deviations[:, 0] / np.maximum(deviations[:, 1], 1e-12)
        return directions[:, :, 0], np.maximum(flatness, 0.0)


def thin(points_m: FloatArray, voxel_size_m: float) -> FloatArray:
    """Replace the points (N, 3) of each voxel by their centroid; return all points if the size is 0.

    Always one thread: with more, voxels at the borders of the threads' shares are split.
    """
    if voxel_size_m == 0.0 or len(points_m) == 0:
        return points_m
    voxels = small_gicp.voxelgrid_sampling(points_m, voxel_size_m, num_threads=1)
    return np.ascontiguousarray(voxels.points()[:, :3])
