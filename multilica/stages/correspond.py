# SPDX-License-Identifier: Apache-2.0
"""Matches of two LiDARs' points by their descriptors."""

import numpy as np
import open3d as o3d

from multilica.config import CorrespondConfig
from multilica.results import Correspondences, FeatureCloud, IndexArray

__all__ = ["match_features"]


def match_features(target: FeatureCloud, source: FeatureCloud, config: CorrespondConfig) -> Correspondences:
    """Match each descriptor of the source with the nearest of the target, the closest matches first.

    With `mutual`, a match is kept only if each is the other's nearest neighbour in descriptor space.
    """
    target, source = (_sample(cloud, config.max_keypoints) for cloud in (target, source))
    pairs = _nearest_pairs(target, source, mutual=config.mutual)
    distances = np.linalg.norm(source.descriptors[pairs[:, 0]] - target.descriptors[pairs[:, 1]], axis=1)
    best = np.lexsort((pairs[:, 0], distances))[: config.max_matches]
    source_index, target_index = pairs[best].T
    return Correspondences(
        target=target.lidar,
        source=source.lidar,
        target_points_m=target.points_m[target_index],
        source_points_m=source.points_m[source_index],
        target_normals=target.normals[target_index],
        source_normals=source.normals[source_index],
        feature_distances=distances[best],
    )


def _sample(cloud: FeatureCloud, most: int) -> FeatureCloud:
    """Draw at most so many descriptors."""
    if len(cloud.points_m) <= most:
        return cloud
    kept = np.sort(np.random.default_rng(0).permutation(len(cloud.points_m))[:most])
    return FeatureCloud(cloud.lidar, cloud.points_m[kept], cloud.normals[kept], cloud.descriptors[kept])


def _nearest_pairs(target: FeatureCloud, source: FeatureCloud, *, mutual: bool) -> IndexArray:
    if len(target.points_m) == 0 or len(source.points_m) == 0:
        return np.empty((0, 2), dtype=np.int64)
    features = [o3d.pipelines.registration.Feature() for _ in range(2)]
    for feature, cloud in zip(features, (source, target), strict=True):
        feature.data = np.ascontiguousarray(cloud.descriptors.T)
    pairs = o3d.pipelines.registration.correspondences_from_features(
        *features, mutual_filter=mutual, mutual_consistency_ratio=0.0
    )
    return np.asarray(pairs, dtype=np.int64).reshape(-1, 2)
