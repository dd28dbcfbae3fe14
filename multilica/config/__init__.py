# SPDX-License-Identifier: Apache-2.0
"""Every parameter of multilica, each once, with its unit, default and meaning."""

from multilica.config.acceptance import AcceptanceConfig
from multilica.config.calibration import PRESETS, STAGES, CalibrationConfig, Stage
from multilica.config.coarse import CoarseConfig
from multilica.config.features import CorrespondConfig, FeaturesConfig
from multilica.config.fine import FineConfig
from multilica.config.ground import GroundConfig
from multilica.config.ingest import IngestConfig
from multilica.config.loading import known_keys, load_config, preset, read_config_table, with_overrides
from multilica.config.merge import JointConfig, MergeConfig, RefineConfig
from multilica.config.preprocess import HealthConfig, PreprocessConfig, StillnessConfig
from multilica.config.runtime import RecordConfig, RuntimeConfig
from multilica.config.section import Section
from multilica.config.verify import VerifyConfig, VisibilityConfig

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
    "VisibilityConfig",
    "known_keys",
    "load_config",
    "preset",
    "read_config_table",
    "with_overrides",
]
