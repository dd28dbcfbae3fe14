# SPDX-License-Identifier: Apache-2.0
"""Libraries that a configuration needs, checked before anything is read or computed."""

from collections.abc import Iterator

from multilica.config import STAGES, CalibrationConfig, Stage
from multilica.optional_libraries import raise_missing, require_library
from multilica.solvers import solver_in_use
from multilica.system_libraries import missing_for_open3d

_LIBRARY_OF_SOLVER = {"maximum_clique": "networkx", "kiss_matcher": "kiss_matcher"}


def require_libraries(config: CalibrationConfig) -> None:
    """Check that the libraries of the configured engines and solver are there, without importing them.

    Raises:
        MissingDependencyError: a library, or a system library that it loads, is missing.
    """
    for wanted, module in _wanted(config):
        require_library(wanted, module)
        if module == "open3d" and missing_for_open3d():
            raise_missing(wanted, module, ImportError("a shared object file is missing"))


def _wanted(config: CalibrationConfig) -> Iterator[tuple[str, str]]:
    """Yield what the stages to run need, with its library."""
    if _runs(config, "features") and config.features.engine == "open3d":
        yield "The engine 'open3d' of features", "open3d"
    solver = solver_in_use(config.coarse)
    if _runs(config, "coarse") and solver in _LIBRARY_OF_SOLVER:
        yield f"The solver '{solver}'", _LIBRARY_OF_SOLVER[solver]
    if _runs(config, "fine") and config.fine.engine == "open3d":
        yield "The engine 'open3d' of fine", "open3d"


def _runs(config: CalibrationConfig, stage: Stage) -> bool:
    return STAGES.index(config.until) >= STAGES.index(stage)
