# SPDX-License-Identifier: Apache-2.0
"""The stages applied to all LiDARs and pairs of a snapshot, on one mutable state.

The package itself is light to import, so that a program can open the workers before it imports the rest.
"""

from contextlib import AbstractContextManager

from multilica.config import CalibrationConfig
from multilica.workers import Workers, open_workers

__all__ = ["open_calibration_workers"]

# Modules that tasks need, imported once for all workers.
_MODULES = tuple(f"multilica.orchestration.{name}" for name in ("clouds", "pairs", "rig"))


def open_calibration_workers(config: CalibrationConfig) -> AbstractContextManager[Workers]:
    """Open the worker processes for calibrations with that configuration; none if it stops before they have work."""
    return open_workers(1 if config.until == "ingest" else config.runtime.workers, _MODULES)
