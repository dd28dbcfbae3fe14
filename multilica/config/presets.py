# SPDX-License-Identifier: Apache-2.0
"""Presets: the values in which each differs from the defaults."""

from collections.abc import Mapping
from typing import Any

_PAPER: Mapping[str, Any] = {
    "stillness": {"enabled": False},
    "preprocess": {"min_range_m": 0.0, "max_range_m": 1e6, "voxel_size_m": 0.0},
    "features": {
        "engine": "open3d",
        "voxel_size_m": 0.35,
        "normal_radius_voxels": 5.0,
        "normal_neighbours": 100,
        "feature_radius_voxels": 5.0,
        "feature_neighbours": 100,
        "max_range_m": 25.0,
        "range_shape": "box",
        "orient_normals": False,
    },
    "correspond": {"engine": "kd_tree", "max_keypoints": 0, "max_matches": 0},
    "coarse": {
        "solver": "teaserpp",
        "noise_bound_m": 0.35,
        "max_hypotheses": 1,
        "normal_tolerance_deg": 180.0,
        "min_agreeing_matches": 0,
    },
    "verify": {"enabled": False},
    "acceptance": {"max_baseline_m": 1e6},
    "fine": {
        "engine": "open3d",
        "voxel_size_m": 0.05,
        "max_points": 1_000_000_000,
        "max_correspondence_distances_m": [1.0],
        "max_iterations": 100,
        "neighbours": 30,
        "fitness_distance_m": 1.0,
    },
    "refine": {"enabled": False},
}
PRESETS: Mapping[str, Mapping[str, Any]] = {
    "default": {"preset": "default"},
    "paper": {**_PAPER, "preset": "paper", "merge": {"mode": "target_first", "fitness_threshold": 0.2}},
    "paper-algorithm1": {
        **_PAPER,
        "preset": "paper-algorithm1",
        "merge": {"mode": "algorithm1", "fitness_threshold": 0.2},
    },
}
