# SPDX-License-Identifier: Apache-2.0
"""Cleaning of a LiDAR's accumulated returns."""

from dataclasses import replace

import numpy as np

from multilica.config import PreprocessConfig, StillnessConfig
from multilica.geometry import lengths, read_only
from multilica.registration.neighbours import thin
from multilica.results import PreprocessedCloud
from multilica.snapshot import LidarScans
from multilica.visibility.moving_points import drop_moving


def preprocess(
    lidar: LidarScans, config: PreprocessConfig, stillness: StillnessConfig | None = None
) -> PreprocessedCloud:
    """Drop returns that do not measure the static scene, and thin the rest.

    Args:
        stillness: None keeps points that move between frames.

    Returns:
        The kept points in the LiDAR's own frame, with the dropped ones by reason.
    """
    moving = np.empty((0, 3))
    if stillness is not None and stillness.enabled:
        scans, moving = drop_moving(lidar.scans, stillness)
        lidar = replace(lidar, scans=scans)
    points_m = lidar.points_m
    range_m = lengths(points_m)
    too_near = range_m < config.min_range_m
    too_far = np.isfinite(range_m) & (range_m > config.max_range_m)
    dropped = {"too_near": points_m[too_near], "too_far": points_m[too_far], "moving": moving}
    kept = points_m[np.isfinite(range_m) & ~too_near & ~too_far]
    return PreprocessedCloud(
        lidar=lidar.name,
        returns_m=read_only(kept, np.float32),
        points_m=read_only(thin(kept, config.voxel_size_m), np.float64),
        dropped_m={reason: points for reason, points in dropped.items() if len(points)},
    )
