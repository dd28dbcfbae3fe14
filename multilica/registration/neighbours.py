# SPDX-License-Identifier: Apache-2.0
"""Neighbourhoods of points: nearest neighbours, planes, voxels."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import small_gicp
from scipy.ndimage import distance_transform_cdt

from multilica.geometry import FloatArray, lengths
from multilica.registration.lazy_open3d import o3d
from multilica.results import BoolArray, IndexArray

# Along the longest side of a cloud: metres per cell, so that a grid costs less than the tree.
_GRID_CELLS = 100
# Ranges of LiDARs are noisy by 1 to 3 cm: the points of one scan line seem to span a plane along the beams.
_LINE_M = 0.05


class PointTree:
    """A k-d tree, twice as fast as SciPy's; a search far from all points is slow, so a bounded one rejects them first.

    Args:
        points_m: (N, 3).

    Attributes:
        cloud: the same points as the type of small_gicp.
    """

    def __init__(self, points_m: FloatArray) -> None:
        self.points_m = np.ascontiguousarray(points_m)
        self.cloud = small_gicp.PointCloud(self.points_m)

    @cached_property
    def engine(self) -> small_gicp.KdTree:
        """The tree as the type of small_gicp, built on first use."""
        return small_gicp.KdTree(self.cloud, num_threads=1)

    def __reduce__(self) -> tuple[object, ...]:
        """Build the tree again in another process: types of the engine cannot be copied."""
        return PointTree, (self.points_m,)

    def nearest(self, points_m: FloatArray) -> tuple[FloatArray, IndexArray]:
        """Return distance (M,) and index (M,) of the nearest neighbour of each of (M, 3) points."""
        index, squared_m2 = self.engine.batch_knn_search(points_m, 1, 1)
        return np.sqrt(squared_m2[:, 0]), index[:, 0].astype(np.int64)

    def nearest_within(self, points_m: FloatArray, reach_m: float) -> tuple[IndexArray, FloatArray, IndexArray]:
        """Find the nearest neighbours of (M, 3) points within a distance.

        Returns:
            Which points have one (K,), its distances (K,), and its indices (K,).
        """
        near = np.flatnonzero(self._grid.at_least_m(points_m) <= reach_m)
        distances_m, index = self.nearest(points_m[near])
        within = distances_m <= reach_m
        return near[within], distances_m[within], index[within]

    def neighbours(self, points_m: FloatArray, count: int) -> IndexArray:
        """Return the indices (M, count) of the nearest neighbours of (M, 3) points; fewer if there are fewer."""
        index, _ = self.engine.batch_knn_search(points_m, min(count, len(self.points_m)), 1)
        return np.asarray(index.astype(np.int64))

    @cached_property
    def _grid(self) -> "_DistanceGrid":
        return _DistanceGrid(self.points_m)


class _DistanceGrid:
    """Cells around points (N, 3), each with the number of cells to the next one with points."""

    def __init__(self, points_m: FloatArray) -> None:
        self._lowest_m = points_m.min(axis=0)
        sides_m = points_m.max(axis=0) - self._lowest_m
        self._cell_m = max(float(sides_m.max()) / _GRID_CELLS, 1e-3)
        empty = np.ones((sides_m / self._cell_m).astype(np.int64) + 1, dtype=np.bool_)
        empty[tuple(((points_m - self._lowest_m) / self._cell_m).astype(np.int64).T)] = False
        self._shape = empty.shape
        self._between = np.maximum(distance_transform_cdt(empty, metric="chessboard") - 1, 0).ravel()

    def at_least_m(self, points_m: FloatArray) -> FloatArray:
        """Return a lower bound (M,) of the distance of each of (M, 3) points to the nearest one in the grid."""
        cell, outside = np.zeros(len(points_m), dtype=np.int64), np.zeros(len(points_m))
        for column, lowest_m, cells in zip(points_m.T, self._lowest_m, self._shape, strict=True):
            along = (column - lowest_m) / self._cell_m
            inside = np.clip(along, 0.0, cells - 1)
            outside = np.maximum(outside, np.abs(along - inside) - 1.0)
            cell = cell * cells + inside.astype(np.int64)
        return np.asarray(self._cell_m * np.maximum(outside, self._between[cell]))


@dataclass(frozen=True, slots=True, eq=False)
class MovedPoints:
    """Nearest neighbours of points that move little: most keep theirs, and need no further search.

    Args:
        tree: of the neighbours.
        points_m: (M, 3) where the points are at first.
        index: (M,) of their nearest neighbours.
        next_m: (M,) distance to the second ones.
    """

    tree: PointTree
    points_m: FloatArray
    index: IndexArray
    next_m: FloatArray

    @classmethod
    def of(cls, tree: PointTree, points_m: FloatArray) -> "MovedPoints":
        """Find the neighbours of points (M, 3)."""
        index, squared_m2 = tree.engine.batch_knn_search(points_m, min(2, len(tree.points_m)), 1)
        return cls(tree, points_m, index[:, 0].astype(np.int64), np.sqrt(squared_m2[:, -1]))

    def subset(self, rows: slice) -> "MovedPoints":
        """Return some of the points."""
        return MovedPoints(self.tree, self.points_m[rows], self.index[rows], self.next_m[rows])

    def nearest(self, points_m: FloatArray) -> tuple[FloatArray, IndexArray]:
        """Return distance (M,) and index (M,) of the nearest neighbour of each point, moved to (M, 3)."""
        index = self.index.copy()
        distance_m = lengths(points_m - self.tree.points_m[index])
        # Another neighbour was at least as far as the second one, and has come nearer by the motion at most.
        open_ = np.flatnonzero(distance_m > self.next_m - lengths(points_m - self.points_m))
        distance_m[open_], index[open_] = self.tree.nearest(points_m[open_])
        return distance_m, index


def spread_and_normals(points_m: FloatArray, neighbours: IndexArray) -> tuple[FloatArray, FloatArray]:
    """Compute how the neighbours of M points spread about their mean.

    Args:
        points_m: (N, 3).
        neighbours: (M, K) indices.

    Returns:
        (M, 3) sums of squares along the principal directions, the smallest first, and (M, 3) the direction of the
        smallest; zero where that is not determined.
    """
    around = [coordinate[neighbours] for coordinate in np.ascontiguousarray(points_m.T)]
    x, y, z = (each - each.mean(axis=1, keepdims=True) for each in around)
    products = ((x, x), (y, y), (z, z), (x, y), (x, z), (y, z))
    return smallest_principal(*(np.einsum("ij,ij->i", one, other) for one, other in products))


def smallest_principal(
    xx: FloatArray, yy: FloatArray, zz: FloatArray, xy: FloatArray, xz: FloatArray, yz: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return eigenvalues (M, 3), ascending, and unit eigenvectors (M, 3) of the smallest of symmetric 3 x 3 matrices.

    In closed form (Smith, Communications of the ACM 1961), which takes a tenth of the time of LAPACK on many.
    """
    mean = (xx + yy + zz) / 3.0
    x, y, z = xx - mean, yy - mean, zz - mean
    size = np.maximum(np.sqrt((x * x + y * y + z * z + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0), 1e-100)
    determinant = x * (y * z - yz * yz) - xy * (xy * z - yz * xz) + xz * (xy * yz - y * xz)
    angle_rad = np.arccos(np.clip(determinant / (2.0 * size**3), -1.0, 1.0)) / 3.0
    largest = mean + 2.0 * size * np.cos(angle_rad)
    smallest = mean + 2.0 * size * np.cos(angle_rad + 2.0 * np.pi / 3.0)
    middle = np.clip(3.0 * mean - largest - smallest, smallest, largest)
    # The eigenvector is normal to the rows of the matrix less the eigenvalue; the longest cross product is exact.
    x, y, z = xx - smallest, yy - smallest, zz - smallest
    crossed = np.stack(
        [
            np.stack([xy * yz - xz * y, xz * xy - x * yz, x * y - xy * xy]),
            np.stack([xy * z - xz * yz, xz * xz - x * z, x * yz - xy * xz]),
            np.stack([y * z - yz * yz, yz * xz - xy * z, xy * yz - y * xz]),
        ]
    )
    # Not by einsum: it adds in another order for a single matrix, and results must not depend on what is in one call.
    squared = crossed[:, 0] ** 2 + crossed[:, 1] ** 2 + crossed[:, 2] ** 2
    longest, one_each = np.argmax(squared, axis=0), np.arange(len(xx))
    length = np.maximum(np.sqrt(squared[longest, one_each]), 1e-100)
    return np.stack([smallest, middle, largest], axis=1), np.asarray(crossed[longest, :, one_each] / length[:, None])


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
        self._on_line = np.empty(count, dtype=np.bool_)

    def at(self, index: IndexArray) -> tuple[FloatArray, FloatArray]:
        """Return unit normals (M, 3) of either sign and flatness (M,) of the points at these (M,) indices.

        Flatness goes from 0 (a twig, a single scan line, a bush) to 1 (a plane). It is 1 - s0 / s1 of the standard
        deviations s0 <= s1 <= s2 along the principal directions: along a twig s1 is as small as s0, in a bush all
        three are alike. Along a scan line, s1 is the noise of the ranges, and s0 nearly zero.
        """
        known = self._known[index]
        if not np.all(known):
            unknown = np.unique(index[~known])
            points_m = self.tree.points_m
            neighbours = self.tree.neighbours(points_m[unknown], self._neighbours)
            variances, self._normals[unknown] = spread_and_normals(points_m, neighbours)
            deviations = np.sqrt(np.maximum(variances, 0.0))
            flatness = 1.0 - deviations[:, 0] / np.maximum(deviations[:, 1], 1e-12)
            on_line = deviations[:, 1] < _LINE_M * np.sqrt(neighbours.shape[1])
            flatness[on_line] = 0.0
            self._flatness[unknown] = np.maximum(flatness, 0.0)
            self._on_line[unknown] = on_line
            self._known[unknown] = True
        return self._normals[index], self._flatness[index]

    def on_line(self, index: IndexArray) -> BoolArray:
        """Return which (M,) of the points at these (M,) indices have neighbours on one scan line only."""
        self.at(index)
        return self._on_line[index]


def thin(points_m: FloatArray, voxel_size_m: float) -> FloatArray:
    """Replace the points (N, 3) of each voxel by their centroid; return all points if the size is 0.

    Always one thread: with more, voxels at the borders of the threads' shares are split.
    """
    if voxel_size_m == 0.0 or len(points_m) == 0:
        return points_m
    voxels = small_gicp.voxelgrid_sampling(points_m, voxel_size_m, num_threads=1)
    return np.ascontiguousarray(voxels.points()[:, :3])


def thin_from_cloud(points_m: FloatArray, voxel_size_m: float) -> FloatArray:
    """Do the same on Open3D's grid, which begins half a voxel below the smallest coordinates, not at the sensor."""
    if voxel_size_m == 0.0 or len(points_m) == 0:
        return points_m
    pcd = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(np.array(points_m)))
    return np.asarray(pcd.voxel_down_sample(voxel_size_m).points)
