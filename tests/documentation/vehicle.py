# SPDX-License-Identifier: Apache-2.0
"""The files that the pages speak of, of one small vehicle: recordings, runs, extrinsics."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from multilica import read_extrinsics, read_snapshot
from multilica.exports import export_extrinsics
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica.snapshot import LidarScans, Scan, Snapshot
from multilica_cli.commands.calibrate import find_sample
from multilica_cli.main import run
from tests.cli.support import ROOT, write_pcd
from tests.ingest.support.recording_writers import write_ros1_bag

LIDARS = ("front", "left", "rear")
FRAMES = 50
FEW_FRAMES = 12
START_NS = 1_777_897_790_000_000_000
"""Ten seconds before the time that a page names: 2026-05-04T12:30:00Z."""
PERIOD_NS = 500_000_000
SHARES = 20
"""A frame is a random twentieth of a scan of the sample, so that no two are equal."""
FEW_SHARES = 2
"""The same for logs of a fleet, in whose single frames the ground and walls must be seen."""
DEAD = np.zeros((0, 3), np.float32)


def write_files(folder: Path) -> None:
    """Write all files into a folder; the names are those of the pages."""
    truth = find_sample().truth
    for name in ("rig.truth.toml", "a.truth.toml", "b.truth.toml", "truth.toml"):
        shutil.copy(truth, folder / name)
    write_snapshot_mcap(_snapshot(0, frames=FRAMES), folder / "drive.mcap")
    for seed, name in enumerate(("monday", "tuesday", "wednesday"), 1):
        write_snapshot_mcap(_snapshot(seed), folder / f"{name}.mcap")
    os.link(folder / "drive.mcap", folder / "snapshot.mcap")
    _write_recorders(folder)
    _write_point_files(folder)
    _write_logs(folder)
    _calibrate(folder)
    cookbook = (ROOT / "docs" / "cookbook.md").read_text(encoding="utf-8")
    tolerances = re.search(r"^```toml\n(# tolerances\.toml.*?)^```", cookbook, re.MULTILINE | re.DOTALL)
    assert tolerances is not None
    (folder / "tolerances.toml").write_text(tolerances[1], encoding="utf-8")
    export_extrinsics(read_extrinsics(truth), folder / "car.urdf", "urdf")
    urdf = (folder / "car.urdf").read_text(encoding="utf-8")
    (folder / "car.urdf").write_text(urdf.replace('"base"', '"base_footprint"'), encoding="utf-8")


def copy_files(folder: Path, place: Path) -> None:
    """Link the files; commands replace files, and never write into one that is there."""
    shutil.copytree(folder, place, copy_function=os.link, dirs_exist_ok=True)


def lose_a_lidar(place: Path) -> None:
    """Calibrate `run/` anew with a LiDAR that returned nothing."""
    write_snapshot_mcap(_snapshot(0, dead="rear"), place / "dead.mcap")
    shutil.rmtree(place / "run")
    assert run(["calibrate", str(place / "dead.mcap"), "--target", "front", "--out", str(place / "run"), "-q"]) == 4


def _snapshot(
    seed: int,
    names: Mapping[str, str] | None = None,
    dead: str = "",
    frames: int = FEW_FRAMES,
    shares: int = SHARES,
) -> Snapshot:
    """The scans of the sample, in which nothing moves; `names` renames LiDARs, and leaves out the others."""
    sample = read_snapshot(find_sample().recording)
    lidars = [
        _lidar(sample[name], called, np.random.default_rng(seed), 0 if name == dead else frames, shares)
        for name, called in (names or dict(zip(LIDARS, LIDARS, strict=True))).items()
    ]
    return Snapshot(tuple(lidars), static_transforms=() if names else sample.static_transforms)


def _lidar(lidar: LidarScans, name: str, rng: np.random.Generator, frames: int, shares: int) -> LidarScans:
    scans = [_scan(lidar.scans[index % len(lidar.scans)], rng, index, shares) for index in range(frames)]
    return LidarScans(name, tuple(scans) or (Scan(DEAD, START_NS),), name, f"/lidar_{name}/points")


def _scan(scan: Scan, rng: np.random.Generator, index: int, shares: int) -> Scan:
    points_m = scan.points_m[rng.integers(0, shares, len(scan.points_m)) == 0]
    stamp_ns = START_NS + index * PERIOD_NS
    return Scan(points_m, stamp_ns, np.ones(len(points_m), np.float32), stamp_ns)


def _write_recorders(folder: Path) -> None:
    write_ros1_bag(_snapshot(0, {"left": "left"}), folder / "left.bag")
    write_ros1_bag(_snapshot(0, {"rear": "right"}), folder / "right.bag")
    write_snapshot_mcap(_snapshot(0, {"front": "roof"}), folder / "roof.mcap")


def _write_point_files(folder: Path) -> None:
    snapshot = _snapshot(0, {"front": "top", "left": "left", "rear": "right"})
    for lidar in snapshot.lidars:
        write_pcd(folder / "scans" / f"{lidar.name}.pcd", lidar.points_m)
    for name in ("top", "left"):
        os.link(folder / "scans" / f"{name}.pcd", folder / f"{name}.pcd")


def _write_logs(folder: Path) -> None:
    logs = folder / "logs" / "bus-7"
    logs.mkdir(parents=True)
    for seed, name in enumerate(("monday", "tuesday")):
        write_snapshot_mcap(_snapshot(seed, frames=FEW_FRAMES // 2, shares=FEW_SHARES), logs / f"{name}.mcap")
    rows = [f"logs/bus-7/{name}.mcap,bus-7,2026-06-0{day}" for day, name in enumerate(("monday", "tuesday"), 1)]
    (folder / "june.csv").write_text("\n".join(["source,vehicle,time", *rows, ""]), encoding="utf-8")


def _calibrate(folder: Path) -> None:
    """Write two runs under the names that the pages give to runs."""
    for recording, name in (("drive", "run"), ("monday", "after")):
        place = str(folder / name)
        assert run(["calibrate", str(folder / f"{recording}.mcap"), "--target", "front", "--out", place, "-q"]) == 0
    for name in ("artifacts", "before", "last", "a", "b", "runs/first"):
        copy_files(folder / "run", folder / name)
    os.link(folder / "run" / "calibration.toml", folder / "calibration.toml")
    os.link(folder / "run" / "recording.rrd", folder / "recording.partial.rrd")
