# SPDX-License-Identifier: Apache-2.0
"""Describe the surroundings of points so that they can be recognised from another sensor."""

from __future__ import annotations

import numpy as np
import open3d as o3d

from multilica.config import FeaturesConfig
from multilica.geometry import read_only
from multilica.results import FeatureCloud, PreprocessedCloud
from multilica.stages.voxel_grid import thin

__all__ = ["compute_features"]

_NORMAL_NEIGHBOURS = 30
_FEATURE_NEIGHBOURS = 100
_FPFH_BINS = 33


def compute_features(cloud: PreprocessedCloud, config: FeaturesConfig) -> FeatureCloud:
    """FPFH (Rusu et al., ICRA 2009) on a voxel grid, with normals that look at the sensor.

    The sign of a normal enters the histogram. Both sensors of a rig see the same side of a surface, so turning
    normals towards the sensor makes descriptors of the two comparable.
    """
    near = np.linalg.norm(cloud.points_m, axis=1) <= config.max_range_m
    points = thin(cloud.points_m[near], config.voxel_size_m)
    if len(points) == 0:
        return FeatureCloud(cloud.lidar, points, np.empty((0, 3)), np.empty((0, _FPFH_BINS)))
    pcd = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    normal_radius_m = config.normal_radius_voxels * config.voxel_size_m
    pcd.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(normal_radius_m, _NORMAL_NEIGHBOURS))
    if config.orient_normals:
        pcd.orient_normals_towards_camera_location(np.zeros(3))
    feature_radius_m = config.feature_radius_voxels * config.voxel_size_m
    search = o3d.geometry.KDTreeSearchParamHybrid(feature_radius_m, _FEATURE_NEIGHBOURS)
    fpfh = o3d.pipelines.registration.compute_fpfh_feature(pcd, search)
    return FeatureCloud(
        lidar=cloud.lidar,
        points_m=read_only(points, np.float64),
        normals=read_only(np.asarray(pcd.normals).reshape(-1, 3), np.float64),
        descriptors=read_only(fpfh.data.T, np.float64),
    )
