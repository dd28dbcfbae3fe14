# SPDX-License-Identifier: Apache-2.0
"""The real scans through every format."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from multilica.ingest import read_snapshot, require_calibratable
from multilica.registration.lazy_open3d import o3d
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica.snapshot import LidarScans, Snapshot
from tests.ingest.support.recording_writers import (
    assert_same_points,
    write_mcap,
    write_mcap_ros2,
    write_ros1_bag,
    write_ros2_bag,
)

SCANS = Path(__file__).parents[3] / "shared" / "data" / "opencalib-0001"

pytestmark = pytest.mark.skipif(not SCANS.is_dir(), reason="the real scans are not beside the project")

WRITERS: dict[str, Callable[[Snapshot, Path], None]] = {
    "snapshot.mcap": write_snapshot_mcap,
    "log.mcap": write_mcap,
    "by_mcap_ros2.mcap": write_mcap_ros2,
    "log.bag": write_ros1_bag,
    "ros2_bag": write_ros2_bag,
}


@pytest.fixture(scope="module")
def scans() -> Snapshot:
    return read_snapshot(SCANS)


def test_the_files_are_read_as_open3d_reads_them(scans: Snapshot) -> None:
    assert scans.names == ("left", "right", "top")
    assert [lidar.points_count for lidar in scans.lidars] == [8572, 9248, 92677]
    require_calibratable(scans)
    for lidar in scans.lidars:
        theirs = o3d.t.io.read_point_cloud(str(SCANS / lidar.topic)).point
        np.testing.assert_array_equal(lidar.scans[0].points_m, theirs.positions.numpy())
        np.testing.assert_array_equal(lidar.scans[0].intensity, theirs.intensity.numpy()[:, 0])


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_points(tmp_path: Path, scans: Snapshot, name: str) -> None:
    on_topics = Snapshot(
        tuple(LidarScans(lidar.name, lidar.scans, topic=f"/{lidar.name}/points") for lidar in scans.lidars)
    )
    WRITERS[name](on_topics, tmp_path / name)
    assert_same_points(read_snapshot(tmp_path / name), scans)
