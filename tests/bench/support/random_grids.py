# SPDX-License-Identifier: Apache-2.0
"""Coarse poses of the preset `paper` where the voxel grid lies elsewhere: how much of its outcome is chance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from multilica.config import preset
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import PreprocessedCloud
from multilica.stages.coarse import find_hypotheses
from multilica.stages.correspond import match_features
from multilica.stages.features import compute_features

# As in the reference: what is left out, the noise, and from where GICP ends right.
_DROPPED_SHARE, _NOISE_M = 0.02, 0.002
_RIGHT_M, _RIGHT_RAD = 2.5, float(np.deg2rad(16.0))


def right_coarse_poses(
    clouds: Mapping[str, FloatArray], target: str, truths: Sequence[RigidTransform], seed: int
) -> dict[str, bool]:
    """Tell per source of the true poses ``T_target_source`` whether its coarse pose is right.

    Args:
        clouds: (N, 3) per LiDAR, in its own frame.
    """
    config = preset("paper")
    # The points are within the range already; the lone one may be beyond.
    within = config.features.model_copy(update={"max_range_m": 2.0 * config.features.max_range_m})
    generator = np.random.default_rng(seed)
    features = {
        name: compute_features(_disturbed(name, clouds[name], generator), within)
        for name in sorted({target} | {truth.source for truth in truths})
    }
    right = {}
    for truth in truths:
        matches = match_features(features[target], features[truth.source], config.correspond)
        found = find_hypotheses(matches, config.coarse, config.acceptance.max_baseline_m).hypotheses
        metres, radians = found[0].T_target_source.distance_to(truth) if found else (np.inf, np.inf)
        right[truth.source] = metres < _RIGHT_M and radians < _RIGHT_RAD
    return right


def _disturbed(name: str, points_m: FloatArray, generator: np.random.Generator) -> PreprocessedCloud:
    """Drop some points, add noise, and place the grid at random by a lone point beyond the smallest coordinates."""
    features = preset("paper").features
    kept = points_m[generator.random(len(points_m)) >= _DROPPED_SHARE]
    kept = kept + generator.normal(0.0, _NOISE_M, kept.shape)
    kept = kept[np.abs(kept).max(axis=1) <= features.max_range_m]
    lone = kept.min(axis=0) - generator.uniform(0.0, features.voxel_size_m, 3)
    moved = np.vstack([kept, lone])
    return PreprocessedCloud(name, moved, moved)
