# SPDX-License-Identifier: Apache-2.0
"""Logs with several stops: one row, from all of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
import tomli_w

from multilica.config import CalibrationConfig, with_overrides
from multilica.extrinsics import Extrinsics, extrinsics_table
from multilica.fleet.store.records import LogRow
from multilica.fleet.store.store import Store, open_store
from multilica.fleet.tasks.run_task import run_log_task
from multilica.geometry import RigidTransform
from multilica.simulate import SimulatedDrive, simulate_drive
from multilica.sinks.snapshots import write_ros2_mcap
from multilica.snapshot import Snapshot
from tests.fleet.support.requests import request
from tests.ingest.support.drive_logs import log_of_stops

pytestmark = pytest.mark.slow

CONFIG = with_overrides(CalibrationConfig(), ["ingest.window=auto", "ingest.frames=1", "runtime.workers=1"])
KNOCK = RigidTransform.from_xyz_rpy("top", "top", (0.05, 0.0, 0.0), (0.0, 0.0, 0.0))


def driven(**changes: object) -> SimulatedDrive:
    options = {"stops": 2, "frames": 1, "sensors": "ideal", "keep_every": 3}
    return simulate_drive("sides", "yard", 4, **(options | changes))


@pytest.fixture(scope="module")
def drive() -> SimulatedDrive:
    return driven()


def known_of(drive: SimulatedDrive) -> Extrinsics:
    return Extrinsics("left", {name: drive.truth.between("left", name) for name in ("right", "top")})


def row_of(log: Snapshot, folder: Path, known: Extrinsics | None = None) -> tuple[LogRow, Store]:
    write_ros2_mcap(log, folder / "drive.mcap")
    store, reference = open_store(str(folder / "store"), create=True), ""
    if known is not None:
        reference = "known.toml"
        store.write(reference, tomli_w.dumps(extrinsics_table(known)).encode())
    return run_log_task(request(folder, "drive.mcap", config=CONFIG, reference=reference)), store


@pytest.mark.in_turn
def test_a_calibration_has_all_stops_of_a_log(drive: SimulatedDrive, tmp_path: Path) -> None:
    row, store = row_of(log_of_stops(drive), tmp_path)
    assert (row.state, row.placed) == ("calibrated", 3)
    document = json.loads(store.read(next(path for path, _ in store.files("") if path.endswith("result.json"))))
    assert [each["name"] for each in document["snapshots"]] == ["stop_1", "stop_2"]


@pytest.mark.in_turn
def test_poses_are_verified_at_all_stops(drive: SimulatedDrive, tmp_path: Path) -> None:
    row, _ = row_of(log_of_stops(drive), tmp_path, known=known_of(drive))
    assert (row.state, row.placed) == ("verified", 3)


@pytest.mark.in_turn
def test_a_lidar_that_moved_later_is_no_longer_verified(drive: SimulatedDrive, tmp_path: Path) -> None:
    log = log_of_stops(driven(moved={"top": KNOCK}, moved_from=1))
    row, _ = row_of(log, tmp_path, known=known_of(drive))
    assert row.state == "calibrated"


@pytest.mark.parametrize("frames", [1, 25])
@pytest.mark.in_turn
def test_one_stop_is_the_longest_standstill(drive: SimulatedDrive, tmp_path: Path, frames: int) -> None:
    """A log with a single frame has none, and needs no option."""
    log = log_of_stops(drive, frames)
    first = Snapshot(tuple(type(each)(each.name, each.scans[:frames], topic=each.topic) for each in log.lidars))
    row, store = row_of(first, tmp_path)
    assert row.state == "calibrated"
    document = json.loads(store.read(next(path for path, _ in store.files("") if path.endswith("result.json"))))
    assert not document["snapshots"]


@pytest.mark.in_turn
@pytest.mark.parametrize(
    ("stops", "told"),
    [
        ("3", "3 stops of different place or heading were asked for, and 1 found."),
        ("auto", "The vehicle drives in this log, and fewer than two stops of a second were found: only frames of one"),
    ],
)
def test_too_few_stops_are_told(drive: SimulatedDrive, tmp_path: Path, stops: str, told: str) -> None:
    config = with_overrides(CONFIG, [f"drive.stops={stops}"])
    log = log_of_stops(drive, 25)
    spans = [slice(0, 1)] if stops == "3" else [slice(0, 35)]
    cut = [replace(each, scans=each.scans[span]) for each in log.lidars for span in spans]
    write_ros2_mcap(Snapshot(tuple(cut)), tmp_path / "drive.mcap")
    row = run_log_task(request(tmp_path, "drive.mcap", config=config))
    assert row.state == "calibrated"
    store = open_store(str(tmp_path / "store"), create=False)
    document = json.loads(store.read(next(path for path, _ in store.files("") if path.endswith("result.json"))))
    assert [note for note in document["input"]["notes"] if note.startswith(told)]
