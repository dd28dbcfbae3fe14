# SPDX-License-Identifier: Apache-2.0
"""What a finished run left behind, read back from its `result.json`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from multilica.errors import SourceNotFoundError
from multilica.fleet.run_documents import read_result_json, require_whole
from multilica.geometry import FloatArray, RigidTransform, read_only
from multilica.sinks.result_files import RESULT_JSON

__all__ = ["SavedPlacement", "SavedRun", "read_run"]


@dataclass(frozen=True, slots=True, eq=False)
class SavedPlacement:
    """Where a run put one LiDAR.

    Args:
        T_target_source: its pose in the run's target frame; None if the run did not place it.
        fitness: of the registration that placed it; None where it is not known.
        reason: the run's own words.
        covariance: (6, 6) of the pose, order rotation (rad), translation (m), both along the target's axes; None where
            the run does not tell.

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
    with require_whole(file):
        return _saved_run(str(file.parent), document)


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


def _saved_run(name: str, document: Mapping[str, Any]) -> SavedRun:
    target = str(document["target"])
    lidars = sorted(document["lidars"].items())
    return SavedRun(name, target, tuple(_placement(target, lidar, entry) for lidar, entry in lidars))


def _placement(target: str, lidar: str, entry: Mapping[str, Any]) -> SavedPlacement:
    pose = None
    if entry["placed"]:
        if entry["T_target_source"] is None:
            raise ValueError(f"LiDAR '{lidar}' is placed, yet without a pose")
        pose = RigidTransform(target, lidar, np.asarray(entry["T_target_source"], dtype=np.float64))
    fitness, covariance = entry["fitness"], entry["covariance"]
    return SavedPlacement(
        lidar,
        pose,
        None if fitness is None else float(fitness),
        str(entry["reason"]),
        None if covariance is None else read_only(covariance, np.float64),
    )


def _is_covariance(matrix: FloatArray) -> bool:
    if matrix.shape != (6, 6) or not np.all(np.isfinite(matrix)):
        return False
    return bool(np.all(np.linalg.eigvalsh(matrix) > 0.0))
