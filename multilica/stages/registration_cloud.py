# SPDX-License-Identifier: Apache-2.0
"""A cloud made ready for GICP once, then used in every registration that it takes part in."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import open3d as o3d
import small_gicp
from scipy.spatial import cKDTree

from multilica.config import FineConfig
from multilica.geometry import FloatArray
from multilica.stages.surface import Surface
from multilica.stages.voxel_grid import thin

__all__ = ["RegistrationCloud", "prepare_registration_cloud"]

_COARSER = 1.2


@dataclass(frozen=True, eq=False)
class RegistrationCloud:
    """Thinned points with what the engine needs to register them.

    Args:
        name: the LiDAR, or the root of a group.
        points_m: (N, 3) in the frame of that name.
        tree: nearest neighbours among `points_m`, for fitness and RMSE.
        engine_cloud, engine_tree: the engine's own types, with covariances.
        neighbours: points from which a covariance is estimated.
    """

    name: str
    points_m: FloatArray
    tree: cKDTree
    engine_cloud: Any
    engine_tree: Any
    neighbours: int

    @cached_property
    def surface(self) -> Surface:
        """The planes that its points lie on."""
        return Surface(self.tree, self.neighbours)


def prepare_registration_cloud(name: str, points_m: FloatArray, config: FineConfig, threads: int) -> RegistrationCloud:
    """Thin, then estimate a covariance per point from its neighbours."""
    thinned, voxel_size_m = thin(points_m, config.voxel_size_m), config.voxel_size_m
    while len(thinned) > config.max_points:
        voxel_size_m *= _COARSER
        thinned = thin(thinned, voxel_size_m)
    prepare = _prepare_small_gicp if config.engine == "small_gicp" else _prepare_open3d
    engine_cloud, engine_tree = prepare(thinned, config, threads)
    return RegistrationCloud(name, thinned, cKDTree(thinned), engine_cloud, engine_tree, config.neighbours)


def _prepare_small_gicp(points_m: FloatArray, config: FineConfig, threads: int) -> tuple[Any, Any]:
    cloud = small_gicp.PointCloud(np.ascontiguousarray(points_m))
    tree = small_gicp.KdTree(cloud, num_threads=threads)
    small_gicp.estimate_normals_covariances(cloud, tree, num_neighbors=config.neighbours, num_threads=threads)
    return cloud, tree


def _prepare_open3d(points_m: FloatArray, config: FineConfig, threads: int) -> tuple[Any, Any]:
    del threads
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_m))
    cloud.estimate_covariances(o3d.geometry.KDTreeSearchParamKNN(config.neighbours))
    return cloud, None
