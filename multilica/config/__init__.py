# SPDX-License-Identifier: Apache-2.0
"""Every parameter of multilica, each once, with its unit, default and meaning."""

from multilica.config.calibration import PRESETS, STAGES, CalibrationConfig, Stage
from multilica.config.loading import known_keys, load_config, preset, read_config_table, with_overrides
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

__all__ = [
    "PRESETS",
    "STAGES",
    "AcceptanceConfig",
    "CalibrationConfig",
    "CoarseConfig",
    "CorrespondConfig",
    "FeaturesConfig",
    "FineConfig",
    "GroundConfig",
    "HealthConfig",
    "IngestConfig",
    "JointConfig",
    "MergeConfig",
    "PreprocessConfig",
    "RecordConfig",
    "RefineConfig",
    "RuntimeConfig",
    "Section",
    "Stage",
    "StillnessConfig",
    "VerifyConfig",
    "known_keys",
    "load_config",
    "preset",
    "read_config_table",
    "with_overrides",
]
