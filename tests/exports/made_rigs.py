# SPDX-License-Identifier: Apache-2.0
"""Rigs whose poses are hard to write down."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from tests.runs.made_runs import write_run

HARD_ANGLES = {
    "even": (0.0, 0.0, 0.0),
    "tiny": (1e-7, -3e-9, 2e-8),
    "half_turn": (math.pi, 0.0, -math.pi / 2),
    "upright": (0.3, math.pi / 2, -0.7),
    "nearly_upright": (0.3, math.pi / 2 - 3e-8, -0.7),
    "nearly_down": (2.0, -math.pi / 2 + 1e-9, 3.0),
    "tilted": (0.4, -0.9, 2.5),
}
XYZ_M = (1.0 / 3.0, -1.23e-7, 12.5)


def made_rig(target: str = "base_link") -> Extrinsics:
    """A frame per entry of `HARD_ANGLES`."""
    poses = {name: RigidTransform.from_xyz_rpy(target, name, XYZ_M, angles) for name, angles in HARD_ANGLES.items()}
    return Extrinsics(target, poses)


def made_run(
    folder: Path,
    *,
    uncertain: bool = False,
    absent: Sequence[str] = (),
    sigmas: tuple[float, float] | None = None,
) -> Path:
    """A run directory with front (the target), left and rear."""
    offsets = {name: None if name in absent else ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)) for name in ("left", "rear")}
    if uncertain:
        return write_run(folder, offsets, sigmas=(1.0, 0.1), status="uncertain")
    return write_run(folder, offsets, sigmas=sigmas)


def name_frames(run: Path, **frame_ids: str) -> None:
    """Give the LiDARs of a run frame ids."""
    document = json.loads((run / "result.json").read_text(encoding="utf-8"))
    document["input"]["lidars"] = {
        name: {"topic": "", "frame_id": frame, "frames": 1, "points": 1} for name, frame in frame_ids.items()
    }
    (run / "result.json").write_text(json.dumps(document), encoding="utf-8")


def assert_same(found: Extrinsics, expected: Extrinsics) -> None:
    """The frames are the same, and no number of a matrix is off by more than 1e-9."""
    assert found.members == expected.members
    for name in sorted(expected.members):
        pose = found.between(expected.target, name)
        np.testing.assert_allclose(
            pose.matrix, expected.between(expected.target, name).matrix, rtol=0, atol=1e-9, err_msg=name
        )
