# SPDX-License-Identifier: Apache-2.0
"""Verification at several stops of a vehicle, one of whose LiDARs is knocked before the last."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from multilica.checks import RigTolerances, verify_stops
from multilica.errors import UnfitSnapshotError
from multilica.extrinsics import extrinsics_table
from multilica.geometry import RigidTransform
from multilica.simulate import SimulatedDrive, simulate_drive
from multilica.sinks.snapshots import write_ros2_mcap, write_snapshot_mcap
from multilica.snapshot import Scan
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke
from tests.ingest.support.drive_logs import log_of_stops

pytestmark = pytest.mark.slow

KNOCK = RigidTransform.from_xyz_rpy("top", "top", (0.05, 0.0, 0.0), (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def drive() -> SimulatedDrive:
    """The LiDAR on the roof was knocked by 5 cm before the last of three stops."""
    options = {"stops": 3, "frames": 1, "sensors": "ideal", "keep_every": 3}
    return simulate_drive("sides", "yard", 4, moved={"top": KNOCK}, moved_from=2, **options)


@pytest.mark.in_turn
def test_a_lidar_that_moved_at_a_later_stop_is_named_with_it(
    drive: SimulatedDrive, invoke: Invoke, tmp_path: Path
) -> None:
    paths = [tmp_path / f"stop{number}.mcap" for number in (1, 2, 3)]
    for path, snapshot in zip(paths, drive.snapshots, strict=True):
        write_snapshot_mcap(snapshot, path)
    (tmp_path / "known.toml").write_text(tomli_w.dumps(extrinsics_table(drive.truth)))
    outcome = invoke("verify", *paths, "--calibration", tmp_path / "known.toml", "--json")
    assert outcome.code == ExitCode.DIFFERENT
    document = json.loads(outcome.out)
    assert document["verdict"] == "outside"
    assert [rig["name"] for rig in document["rigs"]] == ["stop1.mcap", "stop2.mcap", "stop3.mcap"]
    assert [rig["moved"] for rig in document["rigs"]] == [[], [], ["top"]]
    assert document["rigs"][2]["lidars"]["top"]["distance_m"] == pytest.approx(0.05, abs=0.01)
    told = invoke("verify", *paths, "--calibration", tmp_path / "known.toml", "--stops", "1").out.splitlines()[-1]
    assert told == "result of all 3: stop3.mcap: top is outside."


@pytest.fixture
def log(drive: SimulatedDrive, tmp_path: Path) -> Path:
    """A log of the drive beside the poses before the knock."""
    (tmp_path / "known.toml").write_text(tomli_w.dumps(extrinsics_table(drive.truth)))
    write_ros2_mcap(log_of_stops(drive), tmp_path / "drive.mcap")
    return tmp_path / "drive.mcap"


@pytest.mark.in_turn
def test_the_stops_of_a_log_are_verified(invoke: Invoke, log: Path) -> None:
    outcome = invoke("verify", log, "--calibration", log.with_name("known.toml"), "--frames", "1", "--json")
    assert outcome.code == ExitCode.DIFFERENT
    rigs = json.loads(outcome.out)["rigs"]
    assert [(rig["name"], rig["moved"]) for rig in rigs] == [
        ("drive.mcap, stop 1", []),
        ("drive.mcap, stop 2", []),
        ("drive.mcap, stop 3", ["top"]),
    ]
    first = invoke("verify", log, "--calibration", log.with_name("known.toml"), "--frames", "1", "--stops", "1")
    assert first.code == ExitCode.DONE


@pytest.mark.in_turn
def test_the_stops_of_a_log_are_checked(invoke: Invoke, log: Path) -> None:
    given = ("--frames", "1", "--workers", "1", "--out", "run", "--json")
    outcome = invoke("check", log, "--against", log.with_name("known.toml"), *given)
    assert outcome.code == ExitCode.DIFFERENT
    moved = {rig["name"]: rig["moved"] for rig in json.loads(outcome.out)["rigs"]}
    assert moved["run/stop_1"] == moved["run/stop_2"] == []
    assert moved["run/stop_3"] == ["top"]


def test_a_stop_that_cannot_be_used_is_left_out(drive: SimulatedDrive) -> None:
    first = drive.snapshots[0]
    nothing = Scan(np.empty((0, 3), np.float32))
    blind = replace(first, lidars=tuple(replace(lidar, scans=(nothing,)) for lidar in first.lidars))
    (check,) = verify_stops([blind, first], drive.truth, RigTolerances())
    assert check.verdict == "within"
    assert check.notes[-1].startswith("a stop is left out: ")
    with pytest.raises(UnfitSnapshotError):
        verify_stops([blind, blind], drive.truth, RigTolerances())
