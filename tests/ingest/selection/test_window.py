# SPDX-License-Identifier: Apache-2.0
"""Which LiDARs and which of their frames are taken, and what they are called."""

from __future__ import annotations

import sqlite3
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multilica.config import IngestConfig
from multilica.errors import (
    ConfigError,
    SourceNotFoundError,
    UnfitSnapshotError,
    UnknownNameError,
    UnreadableSourceError,
    UsageError,
)
from multilica.geometry import RigidTransform
from multilica.ingest import read_snapshot, require_calibratable
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.ingest.support.recording_writers import (
    CLOUD,
    PERIOD_NS,
    START_NS,
    cloud_message,
    make_snapshot,
    ros2_types,
    write_mcap,
    write_ros1_bag,
    write_ros2_bag,
)

WRITERS = {"a.mcap": write_mcap, "a.bag": write_ros1_bag, "bag": write_ros2_bag}


@pytest.mark.parametrize("name", WRITERS)
def test_frames_from_a_time_on(tmp_path: Path, name: str) -> None:
    WRITERS[name](make_snapshot(frames=8), tmp_path / name)
    snapshot = read_snapshot(tmp_path / name, config=IngestConfig(frames=3, start_s=0.25))
    for index, lidar in enumerate(snapshot.lidars):
        expected = [START_NS + frame * PERIOD_NS + index * 1000 for frame in (3, 4, 5)]
        assert [scan.stamp_ns for scan in lidar.scans] == expected
    assert snapshot.notes == ()


@pytest.mark.parametrize("name", WRITERS)
def test_window_behind_the_end(tmp_path: Path, name: str) -> None:
    WRITERS[name](make_snapshot(frames=8), tmp_path / name)
    with pytest.raises(UnfitSnapshotError, match=r"no point cloud 60 s after its first one: they span 0\.700 s"):
        read_snapshot(tmp_path / name, config=IngestConfig(start_s=60.0))


def test_point_files_have_no_time(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "end_header\n1 2 3\n"
    )
    snapshot = read_snapshot(tmp_path, config=IngestConfig(start_s=1.0))
    assert snapshot.notes == ("Point files have no time: ingest.start_s has no effect.",)


def test_names_come_from_the_frame_id_else_from_the_topic(tmp_path: Path) -> None:
    lidars = make_snapshot(lidars=4, frames=1).lidars
    frames = [("/roof", "/a"), ("base_link", "/b/points"), ("base_link", "/c/points"), ("", "/d/points")]
    written = [LidarScans(topic, lidar.scans, topic=topic) for lidar, (_, topic) in zip(lidars, frames, strict=True)]
    for lidar, (frame_id, _) in zip(written, frames, strict=True):
        object.__setattr__(lidar, "frame_id", frame_id)
    write_mcap(Snapshot(tuple(written)), tmp_path / "a.mcap")
    snapshot = read_snapshot(tmp_path / "a.mcap")
    assert snapshot.names == ("b/points", "c/points", "d/points", "roof")
    assert snapshot["roof"].frame_id == "roof"
    assert snapshot["b/points"].frame_id == "base_link"
    (note,) = snapshot.notes
    assert "/b/points, /c/points have the same frame id 'base_link'" in note


def test_topics_are_chosen_and_renamed(tmp_path: Path) -> None:
    write_mcap(make_snapshot(lidars=3), tmp_path / "a.mcap")
    topics = {"roof": "/lidar_2/points", "front": "/lidar_0/points"}
    snapshot = read_snapshot(tmp_path / "a.mcap", config=IngestConfig(topics=topics))
    assert snapshot.names == ("front", "roof")
    assert snapshot["roof"].frame_id == "lidar_2"
    assert snapshot["roof"].topic == "/lidar_2/points"


def test_unknown_topic_lists_those_with_point_clouds(tmp_path: Path) -> None:
    write_mcap(make_snapshot(), tmp_path / "a.mcap")
    with pytest.raises(UnknownNameError) as caught:
        read_snapshot(tmp_path / "a.mcap", config=IngestConfig(topics={"roof": "/lidar_9/points"}))
    assert caught.value.available == ("/lidar_0/points", "/lidar_1/points")


@pytest.mark.parametrize("topics", [{"a": "/lidar_0/points", "b": "/lidar_0/points"}, {" ": "/lidar_0/points"}])
def test_topics_that_make_no_sense(tmp_path: Path, topics: dict[str, str]) -> None:
    write_mcap(make_snapshot(), tmp_path / "a.mcap")
    with pytest.raises(ConfigError, match=r"In ingest\.topics"):
        read_snapshot(tmp_path / "a.mcap", config=IngestConfig(topics=topics))


@pytest.mark.parametrize("name", WRITERS)
def test_a_recording_without_point_clouds_says_what_it_has(tmp_path: Path, name: str) -> None:
    pose = RigidTransform.identity("base", "lidar")
    WRITERS[name](Snapshot((), static_transforms=(pose,)), tmp_path / name)
    with pytest.raises(
        UnfitSnapshotError, match=r"expected sensor_msgs/msg/PointCloud2, found tf2_msgs/msg/TFMessage\."
    ):
        read_snapshot(tmp_path / name)


def logged(scans: list[Scan], log_times_ns: list[int]) -> list[tuple[str, str, int, bytes]]:
    store = ros2_types()
    clouds = [bytes(store.serialize_cdr(cloud_message(store, scan, "a"), CLOUD)) for scan in scans]
    return [("/a", CLOUD, log_time_ns, data) for log_time_ns, data in zip(log_times_ns, clouds, strict=True)]


def test_frames_are_in_the_order_of_their_stamps(tmp_path: Path) -> None:
    scans = make_snapshot(lidars=1, frames=4).lidars[0].scans
    messages = logged([scans[2], scans[0], scans[3], scans[1]], [START_NS + number for number in range(4)])
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=messages)
    found = read_snapshot(tmp_path / "a.mcap").lidars[0].scans
    assert [scan.stamp_ns for scan in found] == [scan.stamp_ns for scan in scans]
    for scan, expected in zip(found, scans, strict=True):
        np.testing.assert_array_equal(scan.points_m, expected.points_m)


def test_the_window_is_counted_in_log_time(tmp_path: Path) -> None:
    scans = list(make_snapshot(lidars=1, frames=4).lidars[0].scans)
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=logged(scans, [10**9 * number for number in (1, 2, 9, 11)]))
    found = read_snapshot(tmp_path / "a.mcap", config=IngestConfig(start_s=1.5)).lidars[0].scans
    assert [scan.stamp_ns for scan in found] == [scan.stamp_ns for scan in scans[2:]]


def test_a_stamp_of_zero_gives_way_to_the_log_time(tmp_path: Path) -> None:
    scans = [Scan(np.ones((2, 3), np.float32), 0, np.zeros(2, np.float32))] * 2
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=logged(scans, [5, 7]))
    assert [scan.stamp_ns for scan in read_snapshot(tmp_path / "a.mcap").lidars[0].scans] == [5, 7]


def test_a_broken_scan_among_good_ones_is_told(tmp_path: Path) -> None:
    messages = logged(list(make_snapshot(lidars=1, frames=4).lidars[0].scans), [1, 2, 3, 4])
    messages[1] = (*messages[1][:3], messages[1][3][:-40])
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=messages)
    snapshot = read_snapshot(tmp_path / "a.mcap")
    assert len(snapshot.lidars[0].scans) == 3
    (note,) = snapshot.notes
    assert "1 of 4 scans of '/a' are broken and left out" in note
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=messages[1:2])
    with pytest.raises(UnreadableSourceError, match=r"a\.mcap, a scan of '/a' cannot be unpacked"):
        read_snapshot(tmp_path / "a.mcap")


def test_scans_in_several_frames_are_told(tmp_path: Path) -> None:
    scans = make_snapshot(lidars=1, frames=2).lidars[0].scans
    store = ros2_types()
    messages = [
        ("/a", CLOUD, number, bytes(store.serialize_cdr(cloud_message(store, scan, f"frame_{number}"), CLOUD)))
        for number, scan in enumerate(scans)
    ]
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=messages)
    snapshot = read_snapshot(tmp_path / "a.mcap")
    assert snapshot.notes == ("'/a' has scans in several frames (frame_0, frame_1), used as one.",)


def test_a_silent_topic_is_left_out(tmp_path: Path) -> None:
    lidars = make_snapshot(frames=6).lidars
    late = LidarScans("late", lidars[1].scans[:1], topic="/late")
    write_mcap(Snapshot((lidars[0], late)), tmp_path / "a.mcap")
    config = IngestConfig(start_s=0.3)
    snapshot = read_snapshot(tmp_path / "a.mcap", config=config)
    assert snapshot.names == ("lidar_0",)
    ended = "'/late' is left out: its scans end 0.3 s before the window begins; --start 0 has all."
    assert snapshot.notes == (ended,)
    for topic in ("/late", "/lat*"):
        with pytest.raises(UnfitSnapshotError, match=r"no scan of '/late' after 0\.3 s"):
            read_snapshot(tmp_path / "a.mcap", config=config.model_copy(update={"topics": {"late": topic}}))
    assert read_snapshot(tmp_path / "a.mcap", config=config.model_copy(update={"only": ("/*",)})).names == ("lidar_0",)


def test_one_lidar_is_read_but_cannot_be_calibrated(tmp_path: Path) -> None:
    write_mcap(make_snapshot(lidars=1), tmp_path / "a.mcap")
    snapshot = read_snapshot(tmp_path / "a.mcap")
    with pytest.raises(UnfitSnapshotError, match=r"has only one LiDAR \(lidar_0\); calibration needs at least two"):
        require_calibratable(snapshot)


def test_nothing_but_nans_is_read_but_cannot_be_calibrated(tmp_path: Path) -> None:
    blind = Scan(np.full((20, 3), np.nan, np.float32), START_NS, np.zeros(20, np.float32))
    lidars = make_snapshot(lidars=2).lidars
    dead = LidarScans("dead", (blind,), topic="/dead")
    write_mcap(Snapshot((lidars[0], dead)), tmp_path / "one.mcap")
    snapshot = read_snapshot(tmp_path / "one.mcap")
    assert snapshot["dead"].points_count == 0
    with pytest.raises(UnfitSnapshotError, match="finite points of lidar_0 only, none of dead"):
        require_calibratable(snapshot)
    write_mcap(Snapshot((*lidars, dead)), tmp_path / "two.mcap")
    require_calibratable(read_snapshot(tmp_path / "two.mcap"))


def test_a_snapshot_without_lidars_cannot_be_calibrated() -> None:
    with pytest.raises(UnfitSnapshotError, match="has no LiDAR"):
        require_calibratable(Snapshot(()))


def _chatter(path: Path) -> Path:
    path.write_text("It rained on Tuesday.\n" * 30)
    return path


def test_sources_that_are_none(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "readme.txt").write_text("hello")
    (tmp_path / "empty.mcap").touch()
    cases: list[tuple[object, type[Exception], str]] = [
        (tmp_path / "nowhere.mcap", SourceNotFoundError, "Nothing exists at .*nowhere.mcap"),
        (tmp_path / "empty.mcap", UnreadableSourceError, "is empty"),
        (_chatter(tmp_path / "a.mcap"), UnreadableSourceError, "is not an MCAP file, although its name says so"),
        (_chatter(tmp_path / "a.bag"), UnreadableSourceError, "is not a ROS 1 bag, although its name says so"),
        (_chatter(tmp_path / "a.db3"), UnreadableSourceError, "is not an SQLite file"),
        (_chatter(tmp_path / "a.log"), UnreadableSourceError, "has an unknown format"),
        (tmp_path / "folder", UnfitSnapshotError, "holds no point clouds; .* found readme.txt"),
        ([], UsageError, "No source was given"),
        ("/dev/null", UnreadableSourceError, "neither a file nor a folder"),
    ]
    for source, error, sentence in cases:
        with pytest.raises(error, match=sentence) as caught:
            read_snapshot(source)
        assert str(caught.value).endswith(".")


def test_several_recordings_are_refused(tmp_path: Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        write_mcap(make_snapshot(), tmp_path / name)
    with pytest.raises(UsageError, match=r"holds 2 recordings \(a.mcap, b.mcap\); give one of them"):
        read_snapshot(tmp_path)
    with pytest.raises(UsageError, match=r"a\.mcap and .*b\.mcap both hold the LiDAR 'lidar_0'"):
        read_snapshot([tmp_path / "a.mcap", tmp_path / "b.mcap"])
    (tmp_path / "c.pcd").write_text("VERSION 0.7\n")
    with pytest.raises(UsageError, match="is a recording among point files"):
        read_snapshot([tmp_path / "a.mcap", tmp_path / "c.pcd"])
    with pytest.raises(UsageError, match="is given more than once"):
        read_snapshot([tmp_path / "a.mcap", tmp_path / "a.mcap"])


def test_a_recording_beside_point_files_is_ambiguous(tmp_path: Path) -> None:
    write_mcap(make_snapshot(), tmp_path / "a.mcap")
    (tmp_path / "b.pcd").write_text("VERSION 0.7\n")
    with pytest.raises(UsageError, match=r"holds recordings .* and point files"):
        read_snapshot(tmp_path)


def test_a_database_of_something_else(tmp_path: Path) -> None:
    database = sqlite3.connect(tmp_path / "a.db3")
    database.execute("CREATE TABLE songs(id INTEGER)")
    database.commit()
    database.close()
    with pytest.raises(UnreadableSourceError, match=r"is an SQLite file but not a ROS 2 bag: .* found songs"):
        read_snapshot(tmp_path / "a.db3")


@pytest.mark.parametrize("window_s", [0.0, 0.3])
@pytest.mark.parametrize(("rate", "is_told"), [(600, True), (60, True), (40, False), (10, False)])
def test_scans_of_single_packets_are_told(tmp_path: Path, window_s: float, rate: int, is_told: bool) -> None:
    period_ns = 10**9 // rate
    lidars = []
    for lidar in make_snapshot(frames=max(20, rate // 2), points=5).lidars:
        scans = [replace(scan, stamp_ns=START_NS + index * period_ns) for index, scan in enumerate(lidar.scans)]
        lidars.append(replace(lidar, scans=tuple(scans)))
    write_mcap(Snapshot(tuple(lidars)), tmp_path / "a.mcap", chunk_size=1 << 20)
    notes = read_snapshot(tmp_path / "a.mcap", config=IngestConfig(window_s=window_s)).notes
    told = (
        f"'/lidar_0/points', '/lidar_1/points' have up to {rate} scans per second: they may be single packets, with a "
        f"part of the view each; let the driver send whole turns, or take all of a second with --frames {rate}."
    )
    assert (told in notes) == is_told
    assert is_told or not [note for note in notes if "per second" in note]


@pytest.mark.parametrize("stamp_ns", [0, START_NS])
def test_stamps_that_were_never_set_tell_no_rate(tmp_path: Path, stamp_ns: int) -> None:
    (lidar,) = make_snapshot(lidars=1, frames=10).lidars
    store = ros2_types()
    messages = [
        (lidar.topic, CLOUD, scan.stamp_ns, bytes(store.serialize_cdr(cloud_message(store, moved, "a"), CLOUD)))
        for scan in lidar.scans
        for moved in [replace(scan, stamp_ns=stamp_ns)]
    ]
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=messages)
    assert not [note for note in read_snapshot(tmp_path / "a.mcap").notes if "per second" in note]
