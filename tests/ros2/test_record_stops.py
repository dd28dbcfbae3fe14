# SPDX-License-Identifier: Apache-2.0
"""`multilica record ros2:// --stops`: a drive of a running vehicle as one file."""

from __future__ import annotations

from pathlib import Path

import pytest

from multilica.config import IngestConfig
from multilica.ingest import read_drive
from multilica.simulate import simulate_drive
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica_cli.exit_codes import ExitCode
from tests.ingest.support.drive_logs import small_rig
from tests.ros2.processes import HERE, NEEDS_ROS2, multilica, running

STOPS = 2


@pytest.mark.in_turn
@NEEDS_ROS2
@pytest.mark.slow
def test_nodes_are_recorded_stop_by_stop(tmp_path: Path) -> None:
    with small_rig():
        drive = simulate_drive("small", "yard", 4, stops=STOPS, frames=1, sensors="ideal")
    paths = [tmp_path / f"stop{number}.mcap" for number in range(STOPS)]
    for path, snapshot in zip(paths, drive.snapshots, strict=True):
        write_snapshot_mcap(snapshot, path)
    with running(HERE / "drive.py", *paths):
        given = ("--stops", STOPS, "--frames", "3", "--timeout", "10", "--out", "drive.mcap")
        recorded = multilica(tmp_path, "record", "ros2://", *given)
    assert recorded.code == ExitCode.DONE, recorded
    told = [line.partition(":")[0] for line in recorded.err.splitlines()]
    assert [line for line in told if "is good" in line] == [f"Stop {number} of 2 is good" for number in (1, 2)]
    stops = read_drive(tmp_path / "drive.mcap", "auto", config=IngestConfig(frames=3))
    for stop, seen in zip(stops, drive.snapshots, strict=True):
        for lidar in stop.lidars:
            assert {scan.points_m.tobytes() for scan in lidar.scans} == {seen[lidar.name].scans[0].points_m.tobytes()}
