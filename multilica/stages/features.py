# SPDX-License-Identifier: Apache-2.0
"""FPFH descriptors of a LiDAR's points, by our own code or by Open3D.

Rusu, Blodow and Beetz, "Fast Point Feature Histograms (FPFH) for 3D Registration", ICRA 2009.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from multilica.config import FeaturesConfig
from multilica.geometry import FloatArray, read_only
from multilica.registration.lazy_open3d import o3d
from multilica.registration.neighbours import smallest_principal, thin, thin_from_cloud
from multilica.results import FeatureCloud, IndexArray, PreprocessedCloud

FPFH_BINS = 33
"""Bins of a descriptor: 11 for each of the three angles of a pair of points."""

_BINS = FPFH_BINS // 3
_FULL = 100.0
# A plane needs this many points besides the one at its centre.
_LEAST_OF_A_PLANE = 2
# Pairs computed at once: they fit into a core's cache.
_AT_ONCE = 16_384
# Cosines closer than that are equal: they differ by rounding, which differs between CPUs.
_ROUNDING = 1e-9


def compute_features(cloud: PreprocessedCloud, config: FeaturesConfig) -> FeatureCloud:
    """Compute FPFH descriptors (Rusu et al., ICRA 2009) on a voxel grid, with normals that point to the sensor.

    The sign of a normal changes the histogram. Both sensors of a rig see the same side of a surface, so normals that
    point to the sensor make descriptors of the two comparable. Without `orient_normals` the sign is arbitrary.
    """
    points_m = cloud.points_m
    box = config.range_shape == "box"
    range_m = np.abs(points_m).max(axis=1, initial=0.0) if box else np.linalg.norm(points_m, axis=1)
    compute = _compute if config.engine == "numpy" else _compute_open3d
    points, normals, descriptors = compute(points_m[range_m <= config.max_range_m], config)
    return FeatureCloud(
        lidar=cloud.lidar,
        points_m=read_only(points, np.float64),
        normals=read_only(normals, np.float64),
        descriptors=read_only(descriptors, np.float64),
    )


def _compute(points_m: FloatArray, config: FeaturesConfig) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the thinned points (N, 3) with normals (N, 3) and descriptors (N, 33)."""
    points = thin(points_m, config.voxel_size_m)
    if len(points) == 0:
        return points, np.empty((0, 3)), np.empty((0, FPFH_BINS))
    normal_radius_m = config.normal_radius_voxels * config.voxel_size_m
    radius_m = config.feature_radius_voxels * config.voxel_size_m
    around = Neighbourhoods.find(points, max(normal_radius_m, radius_m))
    normals = estimate_normals(points, around.within(normal_radius_m, config.normal_neighbours))
    if config.orient_normals:
        normals[np.einsum("ij,ij->i", normals, points) > 0.0] *= -1.0
    return points, normals, compute_fpfh(points, normals, around.within(radius_m, config.feature_neighbours))


def _compute_open3d(points_m: FloatArray, config: FeaturesConfig) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Do the same with Open3D and its voxel grid."""
    pcd = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(thin_from_cloud(points_m, config.voxel_size_m)))
    if len(pcd.points) == 0:
        return np.empty((0, 3)), np.empty((0, 3)), np.empty((0, FPFH_BINS))
    search = o3d.geometry.KDTreeSearchParamHybrid
    voxel_size_m = config.voxel_size_m
    pcd.estimate_normals(search(config.normal_radius_voxels * voxel_size_m, config.normal_neighbours))
    if config.orient_normals:
        pcd.orient_normals_towards_camera_location(np.zeros(3))
    fpfh = o3d.pipelines.registration.compute_fpfh_feature(
        pcd, search(config.feature_radius_voxels * voxel_size_m, config.feature_neighbours)
    )
    return np.asarray(pcd.points), np.asarray(pcd.normals), np.asarray(fpfh.data).T


@dataclass(frozen=True, eq=False, slots=True)
class Neighbourhoods:
    """Which of N points are near which.

    Args:
        points: N.
        pairs: (2, K) indices of points, each pair once.
        squared_m2: (K,) their squared distance.
        kept: (2, K) whether the second counts as near the first, and the first as near the second.
    """

    points: int
    pairs: IndexArray
    squared_m2: FloatArray
    kept: npt.NDArray[np.bool_]

    @classmethod
    def find(cls, points_m: FloatArray, radius_m: float) -> "Neighbourhoods":
        """Find all within a radius of each of (N, 3) points."""
        tree = cKDTree(points_m, balanced_tree=False, compact_nodes=False)
        pairs = np.ascontiguousarray(tree.query_pairs(radius_m, output_type="ndarray").T)
        apart = _between(points_m, pairs)
        return cls(len(points_m), pairs, _dot(apart, apart), np.ones(pairs.shape, dtype=np.bool_))

    def within(self, radius_m: float, most: int) -> "Neighbourhoods":
        """Keep the `most` nearest of each point, itself counted, within a radius that may be smaller."""
        near = np.flatnonzero(self.squared_m2 <= radius_m**2)
        pairs, squared_m2 = self.pairs.take(near, axis=1), self.squared_m2[near]
        owner, others = pairs.ravel(), most - 1
        count = np.bincount(owner, minlength=self.points)
        crowded = np.flatnonzero((count > others)[owner])
        # By owner, then by distance, in one key.
        share = squared_m2[crowded % max(len(near), 1)] / (2.0 * radius_m**2)
        ordered = crowded[np.argsort(owner[crowded] + share, kind="stable")]
        first = np.concatenate([[0], np.cumsum(np.where(count > others, count, 0))])[owner[ordered]]
        kept = np.ones(len(owner), dtype=np.bool_)
        kept[ordered[np.arange(len(ordered)) - first >= others]] = False
        return Neighbourhoods(self.points, pairs, squared_m2, kept.reshape(2, -1))


def estimate_normals(points_m: FloatArray, around: Neighbourhoods) -> FloatArray:
    """Return the unit normals (N, 3), of either sign, of planes through each of (N, 3) points and those around it."""
    forth, back = (around.pairs[side, around.kept[side]] for side in (0, 1))
    x, y, z = _between(points_m, around.pairs)

    def total(values: FloatArray, sign: float = 1.0) -> FloatArray:
        of_first = np.bincount(forth, weights=values[around.kept[0]], minlength=around.points)
        return of_first + sign * np.bincount(back, weights=values[around.kept[1]], minlength=around.points)

    count = np.bincount(forth, minlength=around.points) + np.bincount(back, minlength=around.points)
    sums = [total(column, -1.0) for column in (x, y, z)]
    products = [
        total(one * other) - sums[i] * sums[j] / (count + 1)
        for one, other, i, j in ((x, x, 0, 0), (y, y, 1, 1), (z, z, 2, 2), (x, y, 0, 1), (x, z, 0, 2), (y, z, 1, 2))
    ]
    _, normals = smallest_principal(*products)
    normals[(count < _LEAST_OF_A_PLANE) | ~normals.any(axis=1)] = (0.0, 0.0, 1.0)
    return normals


def compute_fpfh(points_m: FloatArray, normals: FloatArray, around: Neighbourhoods) -> FloatArray:
    """Compute the descriptors (N, 33) of points (N, 3) with unit normals (N, 3)."""
    size = around.points * FPFH_BINS
    # Pairs that are not kept are counted in a row that is cut off.
    rows = np.where(around.kept, around.pairs, around.points)
    counted = sum(
        np.bincount(row * FPFH_BINS + of_angle, minlength=size + FPFH_BINS)[:size]
        for row, bins in zip(rows, _bins(points_m, normals, around.pairs), strict=True)
        for of_angle in bins
    )
    histograms = np.reshape(counted, (around.points, FPFH_BINS))
    simple = histograms * (_FULL / np.maximum(histograms[:, :_BINS].sum(axis=1), 1))[:, None]
    weight = np.where(around.kept, 1.0 / around.squared_m2, 0.0)
    weights = coo_array((weight.ravel(), (around.pairs.ravel(), around.pairs[::-1].ravel())), (around.points,) * 2)
    summed = (weights @ simple).reshape(-1, 3, _BINS)
    share = summed.sum(axis=2, keepdims=True)
    scaled = np.divide(_FULL * summed, share, out=np.zeros_like(summed), where=share > 0.0)
    return np.asarray(scaled.reshape(-1, FPFH_BINS) + simple)


def _bins(points_m: FloatArray, normals: FloatArray, pairs: IndexArray) -> npt.NDArray[np.uint8]:
    """Return the bins (2, 3, K) of theta, alpha and phi of each pair, seen from its first and from its second point.

    With unit normals n1 and n2 and the unit vector d from the first to the second point, the angles follow from
    n1 * d, n2 * d, n1 * n2 and (d x n1) * n2. The source of a pair is the point whose normal is nearer to d: the same
    from both, so that their bins are.
    """
    bins = np.empty((2, 3, pairs.shape[1]), dtype=np.uint8)
    columns = np.ascontiguousarray(normals.T)
    for start in range(0, pairs.shape[1], _AT_ONCE):
        chunk = slice(start, start + _AT_ONCE)
        first, second = (columns.take(index, axis=1) for index in pairs[:, chunk])
        apart = _between(points_m, pairs[:, chunk])
        apart /= np.sqrt(_dot(apart, apart))
        of_first, of_second, turned = _dot(first, apart), _dot(second, apart), _dot(first, second)
        triple = _dot(np.cross(apart, first, axis=0), second)
        nearer = np.abs(of_second) - np.abs(of_first)
        angles = of_first, of_second, turned, triple
        bins[:, :, chunk] = _bins_of(angles, nearer > 0.0)
        # If both are equally near, each point is the source of its own pair.
        if len(alike := np.flatnonzero(np.abs(nearer) <= _ROUNDING)):
            for side, is_second in enumerate((False, True)):
                bins[side][:, start + alike] = _bins_of([each[alike] for each in angles], is_second)
    return bins


def _bins_of(angles: Sequence[FloatArray], second_is_source: npt.NDArray[np.bool_] | bool) -> npt.NDArray[np.uint8]:
    """Return the bins (3, K) of theta, alpha and phi; `angles` are n1 * d, n2 * d, n1 * n2 and (d x n1) * n2."""
    of_first, of_second, turned, triple = angles
    phi = np.where(second_is_source, -of_second, of_first)
    across = np.sqrt(np.maximum(1.0 - phi * phi, _ROUNDING**2))
    theta = np.arctan2((np.where(second_is_source, -of_first, of_second) - phi * turned) / across, turned)
    shares = np.stack([theta / np.pi, triple / across, phi])
    of_angle = np.clip(0.5 * _BINS * (shares + 1.0), 0, _BINS - 1).astype(np.uint8)
    return np.asarray(of_angle + _BINS * np.arange(3, dtype=np.uint8)[:, None])


def _between(points_m: FloatArray, pairs: IndexArray) -> FloatArray:
    """Return the vectors (3, K) from the first to the second points of pairs (2, K)."""
    columns = np.ascontiguousarray(points_m.T)
    return np.asarray(columns.take(pairs[1], axis=1) - columns.take(pairs[0], axis=1))


def _dot(one: FloatArray, other: FloatArray) -> FloatArray:
    return np.asarray(one[0] * other[0] + one[1] * other[1] + one[2] * other[2])
