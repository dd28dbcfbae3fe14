# SPDX-License-Identifier: Apache-2.0
"""Each bag is read back by `rosbags` and by multilica as the same frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from multilica.geometry import RigidTransform
from multilica.ingest import read_snapshot
from multilica.sinks.snapshots import write_ros1_bag, write_ros2_bag, write_ros2_mcap
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.ingest.support.recording_writers import assert_same_points, assert_same_times, make_snapshot

WRITERS = {"a.bag": write_ros1_bag, "a": write_ros2_bag, "a.mcap": write_ros2_mcap}


@pytest.mark.parametrize("name", WRITERS)
def test_frames_come_back(name: str, tmp_path: Path) -> None:
    snapshot = make_snapshot()
    WRITERS[name](snapshot, tmp_path / name)
    found = read_snapshot(tmp_path / name)
    assert_same_points(found, snapshot)
    assert_same_times(found, snapshot)
    assert (found.notes, found.static_transforms) == ((), ())


@pytest.mark.parametrize("name", WRITERS)
def test_another_reader_takes_it(name: str, tmp_path: Path) -> None:
    snapshot = make_snapshot(frames=2)
    WRITERS[name](snapshot, tmp_path / name)
    if name == "a.mcap":  # rosbags wants a folder with metadata.yaml
        with (tmp_path / name).open("rb") as file:
            times = [message.log_time for _, _, message in make_reader(file, validate_crcs=True).iter_messages()]
    else:
        with AnyReader([tmp_path / name]) as reader:
            assert {each.msgtype for each in reader.connections} == {"sensor_msgs/msg/PointCloud2"}
            times = [time_ns for _, time_ns, _ in reader.messages()]
    assert times == sorted(scan.stamp_ns for lidar in snapshot.lidars for scan in lidar.scans)


@pytest.mark.parametrize("name", WRITERS)
def test_writing_again_gives_the_same_bytes(name: str, tmp_path: Path) -> None:
    files = []
    for folder in (tmp_path / "one", tmp_path / "other"):
        folder.mkdir()
        WRITERS[name](make_snapshot(), folder / name)
        found = sorted(each for each in folder.rglob("*") if each.is_file())
        files.append([(each.name, each.read_bytes()) for each in found])
    assert files[0] == files[1]


@pytest.mark.parametrize("name", WRITERS)
def test_nothing_is_left_of_a_failed_write(name: str, tmp_path: Path) -> None:
    snapshot = make_snapshot()
    broken = replace(snapshot.lidars[1], scans=(Scan(np.zeros((1, 3), np.float32), stamp_ns=2**62),))
    with pytest.raises(Exception, match=r".*"):
        WRITERS[name](replace(snapshot, lidars=(snapshot.lidars[0], broken)), tmp_path / name)
    assert list(tmp_path.iterdir()) == []


def test_a_dead_lidar_and_a_name_without_topic_are_kept(tmp_path: Path) -> None:
    dead = LidarScans("rear", (Scan(np.empty((0, 3), np.float32), 10**18),))
    live = LidarScans("front", (Scan(np.ones((4, 3), np.float32), 10**18),))
    for name, write in WRITERS.items():
        write(Snapshot((live, dead)), tmp_path / name)
        found = read_snapshot(tmp_path / name)
        assert (found["front"].topic, found["front"].points_count) == ("/front/points", 4)
        assert [lidar.points_count for lidar in found.lidars if lidar.name == "rear"] in ([], [0])


def test_an_mcap_has_static_transforms(tmp_path: Path) -> None:
    poses = (RigidTransform.from_xyz_rpy("base", "lidar_0", (1.0, 2.0, 3.0), (0.0, 0.0, 0.5)),)
    snapshot = replace(make_snapshot(), static_transforms=poses)
    write_ros2_mcap(snapshot, tmp_path / "a.mcap")
    found = read_snapshot(tmp_path / "a.mcap")
    assert [(each.target, each.source) for each in found.static_transforms] == [("base", "lidar_0")]
    assert found.static_transforms[0].distance_to(poses[0]) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert_same_times(found, snapshot)


def test_metadata_is_found_by_its_key(tmp_path: Path) -> None:
    write_ros2_mcap(make_snapshot(), tmp_path / "a.mcap", metadata={"vehicle": "v07"})
    with (tmp_path / "a.mcap").open("rb") as file:
        assert [each.metadata for each in make_reader(file).iter_metadata()] == [{"vehicle": "v07"}]
    write_ros2_bag(make_snapshot(), tmp_path / "a", custom_data={"vehicle": "v07"})
    assert "  custom_data:\n    vehicle: v07\n" in (tmp_path / "a" / "metadata.yaml").read_text(encoding="utf-8")
