# SPDX-License-Identifier: Apache-2.0
"""What `inspect` tells about a source."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multilica.config import IngestConfig
from multilica.errors import SourceNotFoundError, UnknownNameError
from multilica.geometry import RigidTransform
from multilica.ingest import inspect_source
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.ingest.support.recording_writers import (
    PERIOD_NS,
    START_NS,
    make_snapshot,
    write_mcap,
    write_ros1_bag,
    write_ros2_bag,
)

WRITERS = {"a.mcap": write_mcap, "a.bag": write_ros1_bag, "bag": write_ros2_bag}


@pytest.mark.parametrize("name", WRITERS)
def test_everything_is_told(tmp_path: Path, name: str) -> None:
    pose = RigidTransform.identity("base", "lidar_0")
    snapshot = Snapshot(make_snapshot(frames=5).lidars, static_transforms=(pose,))
    WRITERS[name](snapshot, tmp_path / name)
    summary = inspect_source(tmp_path / name, config=IngestConfig(frames=3))
    assert summary.objection == ""
    assert summary.notes == ()
    assert summary.source == str(tmp_path / name)
    assert summary.duration_s == pytest.approx(0.400001)
    assert [(other.name, other.message_type, other.count) for other in summary.others] == [
        ("/tf_static", "tf2_msgs/msg/TFMessage", 1)
    ]
    assert [pose.source for pose in summary.static_transforms] == ["lidar_0"]
    first, second = summary.clouds
    assert (first.topic, first.lidar, first.frame_id) == ("/lidar_0/points", "lidar_0", "lidar_0")
    assert first.message_type == "sensor_msgs/msg/PointCloud2"
    assert (first.frames, first.frames_taken) == (5, 3)
    assert first.rate_hz == pytest.approx(10.0)
    assert (first.points_min, first.points_median, first.points_max) == (50, 51, 52)
    assert (second.first_ns, second.last_ns) == (START_NS + 1000, START_NS + 4 * PERIOD_NS + 1000)
    taken = np.concatenate([scan.points_m for scan in snapshot.lidars[0].scans[:3]]).astype(np.float64)
    ranges_m = np.linalg.norm(taken, axis=1)
    assert first.range_max_m == pytest.approx(ranges_m.max())
    assert first.range_median_m == pytest.approx(np.median(ranges_m))


def test_topics_that_are_not_taken_are_told_too(tmp_path: Path) -> None:
    write_mcap(make_snapshot(lidars=3), tmp_path / "a.mcap")
    topics = {"front": "/lidar_0/points", "rear": "/lidar_2/points"}
    summary = inspect_source(tmp_path / "a.mcap", config=IngestConfig(topics=topics))
    assert [(cloud.lidar, cloud.frames_taken) for cloud in summary.clouds] == [("front", 3), ("", 0), ("rear", 3)]
    assert summary.clouds[1].points_median == 51
    assert summary.objection == ""


def test_one_lidar_is_told_with_the_objection(tmp_path: Path) -> None:
    write_mcap(make_snapshot(lidars=1), tmp_path / "a.mcap")
    summary = inspect_source(tmp_path / "a.mcap")
    assert summary.clouds[0].frames_taken == 3
    assert "only one LiDAR (lidar_0)" in summary.objection


def test_no_point_clouds_are_an_objection(tmp_path: Path) -> None:
    pose = RigidTransform.identity("base", "lidar")
    write_mcap(Snapshot((), static_transforms=(pose,)), tmp_path / "a.mcap")
    summary = inspect_source(tmp_path / "a.mcap")
    assert summary.clouds == ()
    assert "found tf2_msgs/msg/TFMessage" in summary.objection
    assert len(summary.static_transforms) == 1


def test_a_blind_lidar_has_no_ranges(tmp_path: Path) -> None:
    blind = Scan(np.full((20, 3), np.nan, np.float32), START_NS, np.zeros(20, np.float32))
    write_mcap(Snapshot((LidarScans("dead", (blind,), topic="/dead"),)), tmp_path / "a.mcap")
    (cloud,) = inspect_source(tmp_path / "a.mcap").clouds
    assert (cloud.points_max, cloud.range_median_m, cloud.range_max_m, cloud.rate_hz) == (0, None, None, None)


def test_a_window_behind_the_end_is_an_objection(tmp_path: Path) -> None:
    write_mcap(make_snapshot(), tmp_path / "a.mcap")
    summary = inspect_source(tmp_path / "a.mcap", config=IngestConfig(start_s=60.0))
    assert "no point cloud 60 s after its first one" in summary.objection
    assert [cloud.frames for cloud in summary.clouds] == [3, 3]


@pytest.mark.parametrize("early", [1, 20, 60])
def test_scans_before_the_clock_was_set_count_for_no_rate(tmp_path: Path, early: int) -> None:
    front, rear = make_snapshot(frames=90).lidars
    first_ns = [replace(scan, stamp_ns=scan.stamp_ns - START_NS + 10**9) for scan in front.scans[:early]]
    lidars = replace(front, scans=(*first_ns, *front.scans[early:])), replace(rear, scans=rear.scans[early:])
    write_mcap(Snapshot(lidars), tmp_path / "a.mcap")
    for start_s in (0.0, 1.0):
        summary = inspect_source(tmp_path / "a.mcap", config=IngestConfig(frames=5, start_s=start_s))
        assert [cloud.frames for cloud in summary.clouds] == [90, 90 - early]
        assert [cloud.rate_hz for cloud in summary.clouds] == pytest.approx([10.0, 10.0], rel=1e-3)
        assert summary.duration_s == pytest.approx((89 - early) / 10.0, abs=1e-3)


def test_point_files_have_no_times(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "end_header\n3 4 0\n"
    )
    summary = inspect_source(tmp_path)
    (cloud,) = summary.clouds
    assert (cloud.topic, cloud.lidar, cloud.first_ns, cloud.rate_hz) == ("a.ply", "a", None, None)
    assert cloud.range_max_m == pytest.approx(5.0)
    assert summary.duration_s is None


def test_requests_that_are_wrong_still_raise(tmp_path: Path) -> None:
    write_mcap(make_snapshot(), tmp_path / "a.mcap")
    with pytest.raises(UnknownNameError):
        inspect_source(tmp_path / "a.mcap", config=IngestConfig(topics={"a": "/nope"}))
    with pytest.raises(SourceNotFoundError):
        inspect_source(tmp_path / "b.mcap")
