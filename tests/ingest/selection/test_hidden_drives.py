# SPDX-License-Identifier: Apache-2.0
"""Drives beside clouds that are no LiDAR, and with clocks that are set while they are recorded."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multilica.config import IngestConfig
from multilica.ingest import inspect_source, stops_of_log
from multilica.simulate import SimulatedDrive, simulate_drive
from multilica.sinks.snapshots import write_ros2_mcap
from multilica.snapshot import LidarScans, Scan
from tests.ingest.support.drive_logs import small_rig

pytestmark = pytest.mark.slow

FEW = IngestConfig(frames=3)
NO_ATTRIBUTES = {"intensity": None, "rings": None, "times_ns": None}


@pytest.fixture(scope="module")
def drive() -> Iterator[SimulatedDrive]:
    """Three stops in a yard, of two LiDARs of a few thousand beams."""
    with small_rig():
        yield simulate_drive("small", "yard", 4, route="turning", stops=3, frames=25, sensors="ideal", with_log=True)


@pytest.mark.parametrize("count", [1, 30])
def test_a_map_that_is_not_chosen_hides_no_drive(drive: SimulatedDrive, tmp_path: Path, count: int) -> None:
    """A larger cloud that never changes, once or again and again."""
    first = drive.log.lidars[0]
    scan = first.scans[0]
    points_m = np.tile(scan.points_m, (3, 1))
    times = [first.scans[len(first.scans) * number // count].stamp_ns + 1 for number in range(count)]
    scans = tuple(replace(scan, points_m=points_m, stamp_ns=time_ns, **NO_ATTRIBUTES) for time_ns in times)
    unchanging = LidarScans("map", scans, "map", "/map")
    write_ros2_mcap(replace(drive.log, lidars=(*drive.log.lidars, unchanging)), tmp_path / "a.mcap")
    config = FEW.model_copy(update={"only": tuple(lidar.topic for lidar in drive.log.lidars)})
    assert len(stops_of_log([tmp_path / "a.mcap"], "auto", config=config)) == 3
    assert "/map" not in inspect_source(tmp_path / "a.mcap", config=config).standstill_evidence


def test_a_clock_that_is_set_in_a_log_hides_no_drive(drive: SimulatedDrive, tmp_path: Path) -> None:
    """The first two frames are logged in 1970."""
    lidars = tuple(
        replace(lidar, scans=tuple(_set_back(scan, is_early=number < 2) for number, scan in enumerate(lidar.scans)))
        for lidar in drive.log.lidars
    )
    write_ros2_mcap(replace(drive.log, lidars=lidars), tmp_path / "a.mcap")
    assert len(stops_of_log([tmp_path / "a.mcap"], "auto", config=FEW)) == 3


def _set_back(scan: Scan, *, is_early: bool) -> Scan:
    time_ns = scan.stamp_ns % 10**11 if is_early else scan.stamp_ns
    return replace(scan, stamp_ns=time_ns, log_time_ns=time_ns)
