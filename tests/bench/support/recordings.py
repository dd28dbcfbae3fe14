# SPDX-License-Identifier: Apache-2.0
"""Recordings to calibrate from the command line, and what that costs."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

from tests.bench.support.cases import NEW_SEEDS
from tests.bench.support.process_cost import Cost, cost_of

SAMPLE = Path(__file__).resolve().parents[3] / "recordings" / "samples" / "edgar-street.mcap"
ONE_WORKER = ("--workers", 1)
_PROGRAM = "multilica_cli"
_NOT_ALL_PLACED = 4


def record(folder: Path, rig: str, scene: str) -> Path:
    """Write the simulated recording of the first new seed into a folder."""
    path = folder / f"{rig}-{scene}.mcap"
    cost_of(_PROGRAM, "simulate", "--rig", rig, "--scene", scene, "--seed", NEW_SEEDS[0], "--out", path)
    return path


def calibration_cost(recording: Path, *options: object, cores: int | None = None) -> Cost:
    """The cost of `multilica calibrate` with all files that it writes; LiDARs may stay unplaced."""
    with tempfile.TemporaryDirectory() as out:
        arguments = (recording, "--out", out, "--quiet", *options)
        return cost_of(_PROGRAM, "calibrate", *arguments, cores=cores, codes=(0, _NOT_ALL_PLACED))


def target_of(recording: Path) -> str:
    """The LiDAR in whose frame the poses of a recording are given."""
    cost = calibration_cost(recording, "--json", *ONE_WORKER)
    return str(json.loads(cost.output)["target"])
