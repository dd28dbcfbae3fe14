# SPDX-License-Identifier: Apache-2.0
"""FPFH descriptors of a LiDAR's points."""

import numpy as np

from multilica.config import FeaturesConfig
from multilica.geometry import read_only
from multilica.registration.lazy_open3d import o3d
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
    pcd = o3d.t.geometry.PointCloud(points)
    pcd.estimate_normals(config.normal_neighbours, config.normal_radius_voxels * config.voxel_size_m)
    if config.orient_normals:
        pcd.orient_normals_towards_camera_location(o3d.core.Tensor(np.zeros(3)))
    fpfh = o3d.t.pipelines.registration.compute_fpfh_feature(
        pcd, config.feature_neighbours, config.feature_radius_voxels * config.voxel_size_m
    )
    return FeatureCloud(
        lidar=cloud.lidar,
        points_m=read_only(points, np.float64),
        normals=read_only(pcd.point.normals.numpy(), np.float64),
        descriptors=read_only(fpfh.numpy(), np.float64),
    )
