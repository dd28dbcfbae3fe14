# SPDX-License-Identifier: Apache-2.0
"""Clouds prepared for GICP, for use in many registrations."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import small_gicp

from multilica.config import FineConfig
from multilica.geometry import FloatArray
from multilica.registration.lazy_open3d import o3d
from multilica.registration.neighbours import PointTree, Surface, thin, thin_from_cloud

# Growth of the voxels until the cloud is small enough: a step removes about a third of the points.
_COARSER = 1.2


@dataclass(frozen=True, eq=False)
class GicpCloud:
    """Thinned points with the engine's structures.

    Args:
        name: the LiDAR, or the root of a group.
        points_m: (N, 3) in the frame of that name.
        tree: nearest neighbours among `points_m`.
        engine_cloud: the engine's own type, with covariances; that of Open3D with normals, from which it makes them.
        engine: name of the engine.
        neighbours: points from which a covariance or a normal is estimated.
    """

    name: str
    points_m: FloatArray
    tree: PointTree
    engine_cloud: Any
    engine: str
    neighbours: int

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle the points; the engine's types cannot be pickled, and are the same bits when computed again."""
        return _with_covariances, (self.name, self.points_m, self.engine, self.neighbours)

    @cached_property
    def surface(self) -> Surface:
        """Planes that its points lie on."""
        return Surface(self.tree, self.neighbours)


def prepare_gicp_cloud(name: str, points_m: FloatArray, config: FineConfig) -> GicpCloud:
    """Thin a cloud on the engine's grid, and estimate a covariance or normal per point from its neighbours."""
    thinned_on_grid = thin if config.engine == "small_gicp" else thin_from_cloud
    thinned, voxel_size_m = thinned_on_grid(points_m, config.voxel_size_m), config.voxel_size_m
    while len(thinned) > config.max_points:
        voxel_size_m *= _COARSER
        thinned = thinned_on_grid(thinned, voxel_size_m)
    return _with_covariances(name, thinned, config.engine, config.neighbours)


def _with_covariances(name: str, points_m: FloatArray, engine: str, neighbours: int) -> GicpCloud:
    tree = PointTree(points_m)
    engine_cloud = tree.cloud
    if engine == "small_gicp":
        small_gicp.estimate_covariances(tree.cloud, tree.engine, num_neighbors=neighbours, num_threads=1)
    else:
        engine_cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(tree.points_m))
        engine_cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(neighbours))
    return GicpCloud(name, tree.points_m, tree, engine_cloud, engine, neighbours)
