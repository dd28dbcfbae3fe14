# SPDX-License-Identifier: Apache-2.0
"""`multilica record --stops`: a drive of a running vehicle, and that of a log, as one file that calibrate reads."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from multilica.config import IngestConfig
from multilica.ingest import frames_recorded, read_drive
from multilica.simulate import SimulatedDrive, simulate_drive
from multilica.sinks.snapshots import write_ros2_mcap, write_snapshot_mcap
from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke
from tests.ingest.support.drive_logs import log_of_stops, small_rig
from tests.ingest.support.processes import served

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def drive() -> Iterator[SimulatedDrive]:
    """Three stops of a vehicle with two small LiDARs."""
    with small_rig():
        yield simulate_drive("small", "yard", 4, stops=3, frames=1, sensors="ideal")


def assert_stops_of(drive: SimulatedDrive, path: Path) -> None:
    """What calibrate reads by default is one snapshot per stop."""
    assert frames_recorded([path]) == 3
    stops = read_drive(path, "auto", config=IngestConfig(frames=3))
    assert [stop.source for stop in stops] == [f"{path.name}, stop {number}" for number in (1, 2, 3)]
    for stop, seen in zip(stops, drive.snapshots, strict=True):
        for lidar in stop.lidars:
            assert len(lidar.scans) == 3
            assert {scan.points_m.tobytes() for scan in lidar.scans} == {seen[lidar.name].scans[0].points_m.tobytes()}


def test_a_running_vehicle_is_led_from_stop_to_stop(drive: SimulatedDrive, invoke: Invoke, tmp_path: Path) -> None:
    paths = [tmp_path / f"stop{number}.mcap" for number in (1, 2, 3)]
    for path, snapshot in zip(paths, drive.snapshots, strict=True):
        write_snapshot_mcap(snapshot, path)
    with served("drive_server.py", 0, *paths) as port:
        given = ("--out", "drive.mcap", "--stops", "3", "--frames", "3")
        outcome = invoke("record", f"ws://127.0.0.1:{port}", *given)
    assert outcome.code == ExitCode.DONE
    told = [line.split(":")[0] for line in outcome.err.splitlines()]
    assert [line for line in told if "is good" in line] == [f"Stop {number} of 3 is good" for number in (1, 2, 3)]
    assert told[1].startswith("The vehicle stands at stop 1")
    assert_stops_of(drive, Path("drive.mcap"))


def test_the_stops_of_a_log_become_a_small_file(drive: SimulatedDrive, invoke: Invoke) -> None:
    write_ros2_mcap(log_of_stops(drive), Path("log.mcap"))
    outcome = invoke("record", "log.mcap", "--out", "drive.mcap", "--stops", "auto", "--frames", "3", "--json")
    assert outcome.code == ExitCode.DONE
    assert [lidar["frames"] for lidar in json.loads(outcome.out)["lidars"]] == [9, 9]
    assert_stops_of(drive, Path("drive.mcap"))
