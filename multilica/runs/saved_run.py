# SPDX-License-Identifier: Apache-2.0
"""Placements of a finished run, read from its `result.json`."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.geometry import FloatArray, RigidTransform, read_only
from multilica.results.document import LidarEntry, ResultDocument
from multilica.runs.run_documents import read_result_json
from multilica.sinks.files.result_files import RESULT_JSON

__all__ = ["SavedPlacement", "SavedRun", "read_run"]


@dataclass(frozen=True, slots=True, eq=False)
class SavedPlacement:
    """The placement of one LiDAR.

    Args:
        T_target_source: its pose in the run's target frame; None if the run did not place it.
        fitness: of the registration that placed it; None if it is not known.
        reason: the reason that the run gives.
        covariance: (6, 6) of the pose, order rotation (rad), translation (m), both along the target's axes; None if
            the run has none.

    Raises:
        ValueError: the covariance is not a positive definite 6x6 matrix.
    """

    lidar: str
    T_target_source: RigidTransform | None
    fitness: float | None
    reason: str
    covariance: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.covariance is not None and not _is_covariance(self.covariance):
            raise ValueError(f"the covariance of LiDAR '{self.lidar}' is not a positive definite 6x6 matrix")


@dataclass(frozen=True, slots=True, eq=False)
class SavedRun:
    """The outcome of one run.

    Args:
        name: the run's directory, as it was given.
        target: the LiDAR that all poses are relative to.
        placements: per LiDAR in name order, the target among them.
    """

    name: str
    target: str
    placements: tuple[SavedPlacement, ...]


def read_run(path: Path) -> SavedRun:
    """Read a run directory or its `result.json`.

    Raises:
        SourceNotFoundError: nothing there, or a directory without a result.
        UnreadableSourceError: not JSON, of another schema, or damaged.
    """
    file = _result_file(path)
    document = read_result_json(file)
    try:
        placements = tuple(_placement(document, lidar, entry) for lidar, entry in sorted(document.lidars.items()))
    except ValueError as error:
        raise UnreadableSourceError(f"{file} is not a whole result: {error}.") from error
    return SavedRun(str(file.parent), document.target, placements)


def _result_file(path: Path) -> Path:
    if not path.exists():
        raise SourceNotFoundError(f"No run at {path}; give a run directory or its {RESULT_JSON}.")
    if not path.is_dir():
        return path
    file = path / RESULT_JSON
    if not file.exists():
        raise SourceNotFoundError(
            f"{path} is not the directory of a finished run: it has no {RESULT_JSON}, "
            "which `multilica calibrate --out` leaves when it ends."
        )
    return file


def _placement(document: ResultDocument, lidar: str, entry: LidarEntry) -> SavedPlacement:
    covariance = None if entry.covariance is None else read_only(entry.covariance, np.float64)
    return SavedPlacement(lidar, document.pose(lidar), entry.fitness, entry.reason, covariance)


def _is_covariance(matrix: FloatArray) -> bool:
    if matrix.shape != (6, 6) or not np.all(np.isfinite(matrix)):
        return False
    return bool(np.all(np.linalg.eigvalsh(matrix) > 0.0))
