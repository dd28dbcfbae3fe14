# SPDX-License-Identifier: Apache-2.0
"""The paper's published default as a bare script: Open3D, the solver and nothing else, as a program of its own.

It reads an MCAP of PointCloud2 messages, or a folder with a compressed PCD file per LiDAR, and prints each LiDAR's pose
in the target's frame as a line of JSON.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from multilica.config import preset
from multilica.registration.lazy_open3d import o3d
from multilica.results import Correspondences
from multilica.solvers import SOLVERS, solver_in_use
from tests.bench.support.kiss_baseline import read_folder, read_mcap

VOXEL_M, RADIUS_M, NEIGHBOURS, HALF_SIDE_M = 0.35, 1.75, 100, 25.0
FINE_VOXEL_M, DISTANCE_M, EPSILON, CHANGE, ITERATIONS = 0.05, 1.0, 0.005, 1e-7, 100


def main(source: str, target: str) -> None:
    """Print the pose of each LiDAR but the target."""
    clouds = read_mcap(source) if source.endswith(".mcap") else read_folder(source)
    coarse = {name: describe(points) for name, points in clouds.items()}
    fine = {name: cloud_of(points).voxel_down_sample(FINE_VOXEL_M) for name, points in clouds.items()}
    for cloud in fine.values():
        cloud.estimate_normals()
    for name in sorted(clouds.keys() - {target}):
        start = solve(name, coarse[name], target, coarse[target])
        pose = refine(fine[name], fine[target], start)
        print(json.dumps({"lidar": name, "T_target_source": pose.tolist()}))


def cloud_of(points: np.ndarray) -> Any:
    """The points (N, 3) as Open3D's type."""
    return o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))


def describe(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Thinned points (N, 3) within the box with their FPFH descriptors (N, 33)."""
    cloud = cloud_of(points[np.abs(points).max(axis=1) <= HALF_SIDE_M]).voxel_down_sample(VOXEL_M)
    search = o3d.geometry.KDTreeSearchParamHybrid(RADIUS_M, NEIGHBOURS)
    cloud.estimate_normals(search)
    return np.asarray(cloud.points), o3d.pipelines.registration.compute_fpfh_feature(cloud, search).data.T


def solve(
    source: str, of_source: tuple[np.ndarray, np.ndarray], target: str, of_target: tuple[np.ndarray, np.ndarray]
) -> np.ndarray:
    """The coarse pose (4, 4) of mutual nearest neighbours, by the solver of the preset."""
    _, nearest = cKDTree(of_target[1]).query(of_source[1])
    _, back = cKDTree(of_source[1]).query(of_target[1])
    kept = np.flatnonzero(back[nearest] == np.arange(len(nearest)))
    target_m, source_m = of_target[0][nearest[kept]], of_source[0][kept]
    unknown = np.zeros_like(source_m)
    distances = unknown[:, 0]
    matches = Correspondences(target, source, target_m, source_m, unknown, unknown, distances, nearest[kept], kept)
    config = preset("paper").coarse
    return SOLVERS[solver_in_use(config)](matches, config).poses[0].matrix


def refine(source: Any, target: Any, start: np.ndarray) -> np.ndarray:
    """The pose (4, 4) after GICP."""
    registration = o3d.pipelines.registration
    criteria = registration.ICPConvergenceCriteria(CHANGE, CHANGE, ITERATIONS)
    estimation = registration.TransformationEstimationForGeneralizedICP(EPSILON)
    found = registration.registration_generalized_icp(source, target, DISTANCE_M, start, estimation, criteria)
    return np.asarray(found.transformation)


if __name__ == "__main__":
    main(*sys.argv[1:])
