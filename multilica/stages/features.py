# SPDX-License-Identifier: Apache-2.0
"""FPFH descriptors of a LiDAR's points."""

import numpy as np

from multilica.config import FeaturesConfig
from multilica.geometry import FloatArray, read_only
from multilica.registration.fpfh import FPFH_BINS, Neighbourhoods, compute_fpfh, estimate_normals
from multilica.registration.lazy_open3d import o3d
from multilica.registration.neighbours import thin, thin_from_cloud
from multilica.results import FeatureCloud, PreprocessedCloud


def compute_features(cloud: PreprocessedCloud, config: FeaturesConfig) -> FeatureCloud:
    """Compute FPFH descriptors (Rusu et al., ICRA 2009) on a voxel grid, with normals that point to the sensor.

    The sign of a normal changes the histogram. Both sensors of a rig see the same side of a surface, so normals that
    point to the sensor make descriptors of the two comparable. Without `orient_normals` the sign is arbitrary.
    """
    near = _range_m(cloud.points_m, config) <= config.max_range_m
    compute = _compute if config.engine == "numpy" else _compute_open3d
    points, normals, descriptors = compute(cloud.points_m[near], config)
    return FeatureCloud(
        lidar=cloud.lidar,
        points_m=read_only(points, np.float64),
        normals=read_only(normals, np.float64),
        descriptors=read_only(descriptors, np.float64),
    )


def _range_m(points_m: FloatArray, config: FeaturesConfig) -> FloatArray:
    """Return what `max_range_m` limits for each of (N, 3) points: distance, or largest coordinate."""
    if config.range_shape == "box":
        return np.asarray(np.abs(points_m).max(axis=1, initial=0.0))
    return np.asarray(np.linalg.norm(points_m, axis=1))


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
