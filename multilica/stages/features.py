# SPDX-License-Identifier: Apache-2.0
"""FPFH descriptors of a LiDAR's points."""

import numpy as np
import open3d as o3d

from multilica.config import FeaturesConfig
from multilica.geometry import read_only
from multilica.registration.neighbours import thin
from multilica.results import FeatureCloud, PreprocessedCloud

__all__ = ["compute_features"]

_FPFH_BINS = 33


def compute_features(cloud: PreprocessedCloud, config: FeaturesConfig) -> FeatureCloud:
    """Compute FPFH descriptors (Rusu et al., ICRA 2009) on a voxel grid, with normals that point to the sensor.

    The sign of a normal changes the histogram. Both sensors of a rig see the same side of a surface, so normals that
    point to the sensor make descriptors of the two comparable.
    """
    near = np.linalg.norm(cloud.points_m, axis=1) <= config.max_range_m
    points = thin(cloud.points_m[near], config.voxel_size_m)
    if len(points) == 0:
        return FeatureCloud(cloud.lidar, points, np.empty((0, 3)), np.empty((0, _FPFH_BINS)))
    pcd = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    normal_radius_m = config.normal_radius_voxels * config.voxel_size_m
    pcd.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(normal_radius_m, config.normal_neighbours))
    if config.orient_normals:
        pcd.orient_normals_towards_camera_location(np.zeros(3))
    feature_radius_m = config.feature_radius_voxels * config.voxel_size_m
    search = o3d.geometry.KDTreeSearchParamHybrid(feature_radius_m, config.feature_neighbours)
    fpfh = o3d.pipelines.registration.compute_fpfh_feature(pcd, search)
    return FeatureCloud(
        lidar=cloud.lidar,
        points_m=read_only(points, np.float64),
        normals=read_only(np.asarray(pcd.normals).reshape(-1, 3), np.float64),
        descriptors=read_only(fpfh.data.T, np.float64),
    )
