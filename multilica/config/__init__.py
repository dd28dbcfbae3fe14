# SPDX-License-Identifier: Apache-2.0
"""Every parameter of multilica, each once, with its unit, default and meaning."""

from multilica.config.loading import PRESETS, known_keys, load_config, preset, read_config_table, with_overrides
from multilica.config.sections import (
    STAGES,
    AcceptanceConfig,
    CalibrationConfig,
    CoarseConfig,
    CorrespondConfig,
    FeaturesConfig,
    FineConfig,
    GroundConfig,
    HealthConfig,
    IngestConfig,
    MergeConfig,
    PreprocessConfig,
    RecordConfig,
    RefineConfig,
    Stage,
    StillnessConfig,
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
    "MergeConfig",
    "PreprocessConfig",
    "RecordConfig",
    "RefineConfig",
    "Stage",
    "StillnessConfig",
    "known_keys",
    "load_config",
    "preset",
    "read_config_table",
    "with_overrides",
]
