# SPDX-License-Identifier: Apache-2.0
"""Runs and truths whose errors are known."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import tomli_w

from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.geometry import RigidTransform
from multilica.results.document import LidarEntry

TRUE_POSES = {
    "front": ((1.5, 0.0, 2.0), (0.0, 5.0, 0.0)),
    "left": ((0.2, 0.7, 2.1), (3.0, 19.0, 88.0)),
    "rear": ((-1.0, 0.1, 1.9), (-2.0, 4.0, 179.0)),
}
Offset = tuple[Sequence[float], Sequence[float]]


def made_truth(target: str = "base") -> Extrinsics:
    poses = {
        name: RigidTransform.from_xyz_rpy(target, name, xyz_m, [math.radians(angle) for angle in rpy_deg])
        for name, (xyz_m, rpy_deg) in TRUE_POSES.items()
    }
    return Extrinsics(target, poses)


def write_truth(path: Path, lidars: Sequence[str] = tuple(TRUE_POSES)) -> Path:
    table = extrinsics_table(made_truth())
    table["lidars"] = {name: table["lidars"][name] for name in lidars}
    path.write_text(tomli_w.dumps(table), encoding="utf-8")
    return path


def write_run(
    path: Path,
    offsets: Mapping[str, Offset | None],
    target: str = "front",
    *,
    sigmas: tuple[float, float] | None = None,
    status: str = "placed",
) -> Path:
    """A run whose poses are off by (dx, dy, dz) m and a turn of (roll, pitch, yaw) deg about the target's axes.

    None stands for a LiDAR that is not placed; `sigmas` (deg, m) for a covariance that is the same in all directions,
    `status` for that of all LiDARs with an offset.
    """
    lidars = {target: entry(RigidTransform.identity(target, target).matrix.tolist())}
    for name, offset in offsets.items():
        if offset is None:
            lidars[name] = entry(None)
            continue
        true = made_truth().between(target, name)
        turn = RigidTransform.from_xyz_rpy(target, target, [0, 0, 0], [math.radians(angle) for angle in offset[1]])
        position = [a + b for a, b in zip(true.xyz_m.tolist(), offset[0], strict=True)]
        found = RigidTransform.from_rotation_translation(target, name, turn.rotation @ true.rotation, position)
        lidars[name] = entry(found.matrix.tolist(), sigmas, status)
    path.mkdir(parents=True)
    (path / "result.json").write_text(json.dumps(made_result(target, lidars)), encoding="utf-8")
    return path


def made_result(target: str, lidars: Mapping[str, object]) -> dict[str, object]:
    """The document of a run with nothing but placements."""
    absent = dict.fromkeys(("refusal", "refinement", "ground"))
    return {
        "schema": "multilica/result/1",
        "status": "partial",
        "target": target,
        "target_reason": "made",
        **absent,
        "pairs": [],
        "decisions": [],
        "snapshots": [],
        "lidars": lidars,
        "timing_s": {},
        "input": {"source": "", "sha256": "", "lidars": {}},
        "config": {},
        "versions": {},
        "platform": "",
    }


def entry(
    matrix: list[list[float]] | None, sigmas: tuple[float, float] | None = None, status: str = "placed"
) -> dict[str, object]:
    status = "not_placed" if matrix is None else status
    values = dict.fromkeys(LidarEntry.model_fields) | {"sigma_from": "residuals", "reason": "made"}
    values["held_by_movable"] = False
    values["covariance"] = None if sigmas is None else covariance(*sigmas).tolist()
    return values | {
        "placed": status == "placed",
        "status": status,
        "T_target_source": matrix,
        "fitness": None if matrix is None else 0.8,
    }


def covariance(sigma_deg: float, sigma_m: float) -> np.ndarray:
    return np.diag([math.radians(sigma_deg) ** 2] * 3 + [sigma_m**2] * 3)
