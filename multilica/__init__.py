# SPDX-License-Identifier: Apache-2.0
"""Extrinsic calibration of the LiDARs of a vehicle, from one stationary snapshot."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multilica.config import CalibrationConfig, load_config, preset
    from multilica.errors import InputError, MultilicaError, UsageError
    from multilica.exports import read_extrinsics
    from multilica.extrinsics import Extrinsics
    from multilica.geometry import RigidTransform
    from multilica.ingest import read_prior, read_snapshot
    from multilica.results import CalibrationResult
    from multilica.run import CalibrationRun, run_calibration
    from multilica.snapshot import LidarScans, Scan, Snapshot
    from multilica.source_calibration import calibrate

__version__ = "0.1.0"

_NAMES = {
    "config": ("CalibrationConfig", "load_config", "preset"),
    "errors": ("InputError", "MultilicaError", "UsageError"),
    "exports": ("read_extrinsics",),
    "extrinsics": ("Extrinsics",),
    "geometry": ("RigidTransform",),
    "ingest": ("read_prior", "read_snapshot"),
    "results": ("CalibrationResult",),
    "run": ("CalibrationRun", "run_calibration"),
    "snapshot": ("LidarScans", "Scan", "Snapshot"),
    "source_calibration": ("calibrate",),
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
    for module, names in _NAMES.items():
        if name in names:
            return getattr(import_module(f"multilica.{module}"), name)
    raise AttributeError(f"module 'multilica' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
