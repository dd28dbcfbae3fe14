# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from multilica import read_extrinsics, read_snapshot
from multilica.geometry import RigidTransform
from multilica.simulate import thinned
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica_cli.commands.calibrate import find_sample

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


Invoke = Callable[..., Outcome]


def assert_one_sentence(outcome: Outcome, code: int) -> None:
    assert outcome.code == code, outcome
    assert len(outcome.err.splitlines()) == 1, outcome.err
    assert outcome.err.startswith("multilica: ")
    assert outcome.err.rstrip().endswith((".", "?"))
    assert "Traceback" not in outcome.out + outcome.err


def command_of_process(*arguments: str | Path) -> list[str]:
    return [sys.executable, "-m", "multilica_cli", *map(str, arguments)]


def environment_of_process() -> dict[str, str]:
    path = os.pathsep.join((str(ROOT), str(ROOT / "cli")))
    return {**os.environ, "PYTHONPATH": path, "PYTHONUNBUFFERED": "1"}


def write_pcd(path: Path, points: Sequence[Sequence[float]] | np.ndarray) -> Path:
    """An ascii PCD file with fields x y z."""
    rows = [" ".join(str(float(value)) for value in point) for point in points]
    header = (
        "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
        f"WIDTH {len(rows)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(rows)}\nDATA ascii\n"
    )
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(header + "\n".join(rows) + "\n", encoding="ascii")
    return path


def write_recording(path: Path, points: Mapping[str, np.ndarray]) -> Path:
    """An MCAP with one frame of each LiDAR."""
    lidars = (
        LidarScans(name, (Scan(cloud.astype(np.float32), 1),), topic=f"/{name}") for name, cloud in points.items()
    )
    write_snapshot_mcap(Snapshot(tuple(lidars)), path)
    return path


def write_thinned_sample(path: Path, keep_every: int = 3) -> Path:
    """A recording with a part of the points of the embedded sample, which is calibrated in less time."""
    write_snapshot_mcap(thinned(read_snapshot(find_sample().recording), keep_every), path)
    return path


def true_pose(target: str, source: str) -> RigidTransform:
    """`T_target_source` of two LiDARs of the embedded sample."""
    return read_extrinsics(find_sample().truth).between(target, source)
