# SPDX-License-Identifier: Apache-2.0
"""Where every LiDAR of a vehicle sits, from one stationary snapshot."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multilica.config import CalibrationConfig, load_config, preset
    from multilica.errors import InputError, MultilicaError, UsageError
    from multilica.extrinsics import Extrinsics, read_extrinsics
    from multilica.geometry import RigidTransform
    from multilica.ingest import read_prior, read_snapshot
    from multilica.pipeline import calibrate
    from multilica.results import CalibrationResult
    from multilica.run import CalibrationRun, run_calibration
    from multilica.snapshot import LidarScans, Scan, Snapshot

__version__ = "0.1.0"

_HOMES = {
    "CalibrationConfig": "config",
    "CalibrationResult": "results",
    "CalibrationRun": "run",
    "Extrinsics": "extrinsics",
    "InputError": "errors",
    "LidarScans": "snapshot",
    "MultilicaError": "errors",
    "RigidTransform": "geometry",
    "Scan": "snapshot",
    "Snapshot": "snapshot",
    "UsageError": "errors",
    "calibrate": "pipeline",
    "load_config": "config",
    "preset": "config",
    "read_extrinsics": "extrinsics",
    "read_prior": "ingest",
    "read_snapshot": "ingest",
    "run_calibration": "run",
}

__all__ = [
    "CalibrationConfig",
    "CalibrationResult",
    "CalibrationRun",
    "Extrinsics",
    "InputError",
    "LidarScans",
    "MultilicaError",
    "RigidTransform",
    "Scan",
    "Snapshot",
    "UsageError",
    "__version__",
    "calibrate",
    "load_config",
    "preset",
    "read_extrinsics",
    "read_prior",
    "read_snapshot",
    "run_calibration",
]


def __getattr__(name: str) -> object:
    """Import a public name when it is first used, so that ``import multilica`` stays light."""
    if name not in _HOMES:
        raise AttributeError(f"module 'multilica' has no attribute '{name}'")
    return getattr(import_module(f"multilica.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
