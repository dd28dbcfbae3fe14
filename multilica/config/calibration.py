# SPDX-License-Identifier: Apache-2.0
"""The whole configuration with its presets."""

from collections.abc import Mapping
from typing import Any, Literal, get_args

from pydantic import Field

from multilica.config.sections import (
    AcceptanceConfig,
    CoarseConfig,
    CorrespondConfig,
    FeaturesConfig,
    FineConfig,
    GroundConfig,
    HealthConfig,
    IngestConfig,
    JointConfig,
    MergeConfig,
    PreprocessConfig,
    RecordConfig,
    RefineConfig,
    RuntimeConfig,
    Section,
    StillnessConfig,
    VerifyConfig,
)

Stage = Literal[
    "ingest", "preprocess", "features", "correspond", "coarse", "verify", "fine", "merge", "refine", "ground"
]
STAGES: tuple[Stage, ...] = get_args(Stage)


class CalibrationConfig(Section):
    """The whole configuration; one table per section."""

    preset: Literal["default", "paper", "paper-algorithm1"] = Field(
        "default", description="preset that the configuration started from"
    )
    target: str = Field("", description="name of the target LiDAR; empty: the one with the most overlap")
    until: Stage = Field("ground", description="the last stage to run")
    ingest: IngestConfig = IngestConfig()
    stillness: StillnessConfig = StillnessConfig()
    preprocess: PreprocessConfig = PreprocessConfig()
    health: HealthConfig = HealthConfig()
    features: FeaturesConfig = FeaturesConfig()
    correspond: CorrespondConfig = CorrespondConfig()
    coarse: CoarseConfig = CoarseConfig()
    verify: VerifyConfig = VerifyConfig()
    fine: FineConfig = FineConfig()
    acceptance: AcceptanceConfig = AcceptanceConfig()
    merge: MergeConfig = MergeConfig()
    refine: RefineConfig = RefineConfig()
    joint: JointConfig = JointConfig()
    ground: GroundConfig = GroundConfig()
    runtime: RuntimeConfig = RuntimeConfig()
    record: RecordConfig = RecordConfig()


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
