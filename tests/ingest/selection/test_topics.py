# SPDX-License-Identifier: Apache-2.0
"""Topics by pattern and type, times by clock, frames spread over a window."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from multilica.config import CalibrationConfig, IngestConfig, with_overrides
from multilica.errors import ConfigError, UnfitSnapshotError, UnknownNameError, UnreadableSourceError, UsageError
from multilica.ingest import inspect_source, read_snapshot
from multilica.pointcloud2 import MERGED_TOPIC
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.ingest.support.format_writers import livox_messages, write_raw_mcap
from tests.ingest.support.recording_writers import (
    CLOUD,
    PERIOD_NS,
    START_NS,
    assert_same_points,
    cloud_message,
    make_snapshot,
    raw_messages,
    ros2_types,
    write_mcap,
    write_ros1_bag,
    write_ros2_bag,
)

WRITERS = {
    "a.mcap": write_mcap,
    "unindexed.mcap": lambda snapshot, path: write_mcap(snapshot, path, indexed=False),
    "a.bag": write_ros1_bag,
    "bag": write_ros2_bag,
}


@pytest.fixture
def mixed(tmp_path: Path) -> Path:
    """Two topics of PointCloud2, two of Livox."""
    lidars = make_snapshot(lidars=4).lidars
    messages = [*raw_messages(Snapshot(lidars[:2]), ros2_types(), "cdr")]
    messages += livox_messages(Snapshot(lidars[2:]), "livox_ros_driver2", "cdr")
    write_raw_mcap(iter(messages), tmp_path / "mixed.mcap", "cdr")
    return tmp_path / "mixed.mcap"


@pytest.mark.parametrize(
    ("only", "names"),
    [
        (("/lidar_1/points",), ("lidar_1",)),
        (("/lidar_[12]/*",), ("lidar_1", "lidar_2")),
        (("livox_ros_driver2/msg/CustomMsg",), ("lidar_2", "lidar_3")),
        (("livox_ros_driver2/CustomMsg", "/lidar_0/points"), ("lidar_0", "lidar_2", "lidar_3")),
        (("/*", "/lidar_0/points"), ("lidar_0", "lidar_1", "lidar_2", "lidar_3")),
    ],
)
def test_topics_by_name_pattern_and_type(mixed: Path, only: tuple[str, ...], names: tuple[str, ...]) -> None:
    assert read_snapshot(mixed, config=IngestConfig(only=only)).names == names


def test_a_pattern_can_give_a_name_if_it_is_one_topic(mixed: Path) -> None:
    config = IngestConfig(topics={"roof": "/*_3/points"}, only=("/lidar_3/points", "/lidar_0/points"))
    assert read_snapshot(mixed, config=config).names == ("lidar_0", "roof")
    with pytest.raises(ConfigError, match=r"'/\*_\[01\]/points' is several topics for the LiDAR 'roof'"):
        read_snapshot(mixed, config=IngestConfig(topics={"roof": "/*_[01]/points"}))
    with pytest.raises(ConfigError, match="has several names: front, roof"):
        read_snapshot(mixed, config=IngestConfig(topics={"front": "/lidar_0/points", "roof": "/*_0/points"}))
    with pytest.raises(UnknownNameError, match="no point cloud topic '/radar"):
        read_snapshot(mixed, config=IngestConfig(only=("/radar*",)))


@pytest.mark.parametrize(
    "start_at", ["2023-11-14T22:13:20.250+00:00", "1700000000.25", "1700000000250000000", "2023-11-14T22:13:20.25"]
)
def test_an_absolute_time(tmp_path: Path, start_at: str) -> None:
    write_mcap(make_snapshot(frames=8), tmp_path / "a.mcap")
    config = IngestConfig(frames=2, start_at=start_at)
    first, _ = read_snapshot(tmp_path / "a.mcap", config=config).lidars
    assert [scan.stamp_ns for scan in first.scans] == [START_NS + frame * PERIOD_NS for frame in (3, 4)]


def test_times_that_make_no_sense(tmp_path: Path) -> None:
    write_mcap(make_snapshot(), tmp_path / "a.mcap")
    with pytest.raises(ConfigError, match="Cannot read the time 'noon'"):
        read_snapshot(tmp_path / "a.mcap", config=IngestConfig(start_at="noon"))
    with pytest.raises(ConfigError, match=r"start_s and ingest\.start_at"):
        read_snapshot(tmp_path / "a.mcap", config=IngestConfig(start_at="17e8", start_s=1.0))
    with pytest.raises(UnfitSnapshotError, match=r"no point cloud at 2024-01-01: they span 2023-11-14T22:13:20\.000"):
        read_snapshot(tmp_path / "a.mcap", config=IngestConfig(start_at="2024-01-01"))
    config = with_overrides(CalibrationConfig(), ["ingest.start_at=2023-11-14T22:13:20Z"])
    assert len(read_snapshot(tmp_path / "a.mcap", config=config.ingest).lidars[0].scans) == 3


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("scale", [1, 40])
def test_frames_are_spread_over_a_window(tmp_path: Path, name: str, scale: int) -> None:
    """With and without gaps over which an indexed recording is worth a jump."""
    lidars = tuple(
        LidarScans(lidar.name, tuple(slowed(scan, scale) for scan in lidar.scans), topic=lidar.topic)
        for lidar in make_snapshot(frames=20).lidars
    )
    WRITERS[name](Snapshot(lidars), tmp_path / name)
    config = IngestConfig(frames=4, start_s=0.35 * scale, window_s=1.2 * scale)
    snapshot = read_snapshot(tmp_path / name, config=config)
    assert snapshot.notes == ()
    for index, lidar in enumerate(snapshot.lidars):
        expected = [START_NS + scale * (frame * PERIOD_NS + 1000 * index) for frame in (4, 7, 10, 13)]
        assert [scan.stamp_ns for scan in lidar.scans] == expected
    shortened = read_snapshot(tmp_path / name, config=config.model_copy(update={"start_s": 1.75 * scale}))
    assert [len(lidar.scans) for lidar in shortened.lidars] == [2, 2]
    (note,) = shortened.notes
    assert note.startswith("The recording ends ")
    assert note.endswith(" s after the window begins; frames are spread over that time.")


def slowed(scan: Scan, scale: int) -> Scan:
    return Scan(scan.points_m, START_NS + scale * (scan.stamp_ns - START_NS), scan.intensity)


def halves(tmp_path: Path) -> tuple[Snapshot, list[Path]]:
    snapshot = make_snapshot(lidars=4, frames=4)
    paths = [tmp_path / "left.mcap", tmp_path / "right.bag"]
    for part, (write, path) in enumerate(zip((write_mcap, write_ros1_bag), paths, strict=True)):
        write(Snapshot(snapshot.lidars[2 * part : 2 * part + 2]), path)
    return snapshot, paths


def test_a_recorder_per_lidar(tmp_path: Path) -> None:
    snapshot, paths = halves(tmp_path)
    found = read_snapshot(paths)
    assert found.notes == ()
    assert_same_points(found, snapshot)
    summary = inspect_source(paths)
    assert summary.format == "MCAP beside ROS 1 bag"
    assert [cloud.frames for cloud in summary.clouds] == [4, 4, 4, 4]
    later = read_snapshot(paths, config=IngestConfig(frames=1, start_s=0.15))
    assert {lidar.scans[0].stamp_ns // PERIOD_NS for lidar in later.lidars} == {START_NS // PERIOD_NS + 2}
    spread = read_snapshot(paths, config=IngestConfig(frames=2, window_s=0.2))
    assert [len(lidar.scans) for lidar in spread.lidars] == [2, 2, 2, 2]


def test_recorders_that_call_their_topics_alike(tmp_path: Path) -> None:
    lidars = make_snapshot().lidars
    for lidar in lidars:
        alike = LidarScans(lidar.name, lidar.scans, topic="/points")
        write_mcap(Snapshot((alike,)), tmp_path / f"{lidar.name}.mcap")
    snapshot = read_snapshot([tmp_path / "lidar_0.mcap", tmp_path / "lidar_1.mcap"])
    assert snapshot.names == ("lidar_0", "lidar_1")
    assert [lidar.topic for lidar in snapshot.lidars] == ["lidar_0.mcap:/points", "lidar_1.mcap:/points"]


def test_a_recorder_that_died_among_others(tmp_path: Path) -> None:
    snapshot, paths = halves(tmp_path)
    content = paths[1].read_bytes()
    paths[1].write_bytes(content[: len(content) // 2])
    found = read_snapshot(paths)
    assert [len(found[lidar.name].scans) for lidar in snapshot.lidars[:2]] == [4, 4]
    assert any("then the file ends too early" in note for note in found.notes)
    (tmp_path / "copy.mcap").write_bytes(paths[0].read_bytes())
    with pytest.raises(UsageError, match="both hold the LiDAR 'lidar_0'"):
        read_snapshot([paths[0], tmp_path / "copy.mcap"])


def logged(scans: list[tuple[str, Scan, int]]) -> list[tuple[str, str, int, bytes]]:
    store = ros2_types()
    return [
        (
            f"/{name}",
            "sensor_msgs/msg/PointCloud2",
            log_time_ns,
            bytes(store.serialize_cdr(message, message.__msgtype__)),
        )
        for name, scan, log_time_ns in scans
        for message in [cloud_message(store, scan, name)]
    ]


def odd(tmp_path: Path, scans: list[Scan], **options: object) -> Snapshot:
    messages = logged([("a", scan, START_NS + 1 + number) for number, scan in enumerate(scans)])
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=messages)
    return read_snapshot(tmp_path / "a.mcap", config=IngestConfig(**options))


def test_lidars_with_clocks_of_their_own(tmp_path: Path) -> None:
    messages = []
    for lidar, behind_ns in zip(make_snapshot().lidars, (0, 37 * 10**9), strict=True):
        for number, scan in enumerate(lidar.scans):
            late = Scan(scan.points_m, scan.stamp_ns - behind_ns, scan.intensity)
            messages.append((lidar.name, late, START_NS + number * PERIOD_NS + 10**7))
    write_mcap(Snapshot(()), tmp_path / "a.mcap", messages=logged(messages))
    snapshot = read_snapshot(tmp_path / "a.mcap", config=IngestConfig(frames=2, start_s=0.05))
    assert [len(lidar.scans) for lidar in snapshot.lidars] == [2, 2]
    (note,) = snapshot.notes
    assert note == (
        "The stamps lag behind the log time: '/lidar_0' by 0.010 s, '/lidar_1' by 37.010 s; "
        "the frames were chosen by log time."
    )


def _sent_on_one_topic(tmp_path: Path, frame_ids: str, ids: list[int]) -> Snapshot:
    """Clouds of Livox with these numbers, and PointCloud2 of these frames, each on one topic beside a third one."""
    scans = make_snapshot(lidars=1, frames=6).lidars[0].scans
    store, kind = ros2_types(), "livox_ros_driver2/msg/CustomMsg"
    lidar = LidarScans("livox", scans, topic="/livox/lidar")
    livox = [*livox_messages(Snapshot((lidar,)), "livox_ros_driver2", "cdr")]
    clouds = [
        ("/points", CLOUD, START_NS + number, bytes(store.serialize_cdr(cloud_message(store, scan, frame_id), CLOUD)))
        for number, (frame_id, scan) in enumerate(zip(frame_ids, scans, strict=False))
    ]
    numbered = []
    for (topic, _, time_ns, data), number in zip(livox, ids, strict=False):
        at = data.index(time_ns.to_bytes(8, "little")) + 12  # behind the time base and the number of points
        numbered.append((topic, kind, time_ns, data[:at] + bytes([number]) + data[at + 1 :]))
    write_raw_mcap(iter([*clouds, *numbered]), tmp_path / "a.mcap", "cdr")
    return read_snapshot(tmp_path / "a.mcap")


def test_several_lidars_on_one_topic_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnfitSnapshotError, match=r"'/livox/lidar' holds .* 2 LiDARs \(lidar_id 1, lidar_id 7\)"):
        _sent_on_one_topic(tmp_path, "aaaa", [7, 1, 7, 1])
    with pytest.raises(UnfitSnapshotError, match=r"'/points' holds .* 2 LiDARs \(a, b\); .*multi_topic: 1"):
        _sent_on_one_topic(tmp_path, "abab", [7, 7])
    assert "only one LiDAR" in inspect_source(tmp_path / "a.mcap", config=IngestConfig(only=("/l*",))).objection


def test_a_frame_that_is_renamed_is_one_lidar(tmp_path: Path) -> None:
    snapshot = _sent_on_one_topic(tmp_path, "aabb", [7, 7, 7, 7])
    assert [len(lidar.scans) for lidar in snapshot.lidars] == [4, 4]
    assert snapshot.notes[0] == "'/points' has scans in several frames (a, b), used as one."


def test_scans_that_are_there_twice_are_taken_once(tmp_path: Path) -> None:
    scans = list(make_snapshot(lidars=1).lidars[0].scans)
    snapshot = odd(tmp_path, [scans[0], scans[0], scans[1], scans[1], scans[2]])
    assert len(snapshot.lidars[0].scans) == 3
    assert snapshot.notes == ("'/a' holds 2 scans twice; each was used once.",)
    with pytest.raises(UnreadableSourceError, match=r"a\.mcap is refused, as ingest\.strict is set: '/a' holds 1 "):
        odd(tmp_path, [scans[0], scans[0]], strict=True)


def test_empty_and_zero_clouds_are_told(tmp_path: Path) -> None:
    scan = make_snapshot(lidars=1).lidars[0].scans[0]
    zeros = Scan(np.zeros((9, 3), np.float32), START_NS + 1, np.zeros(9, np.float32))
    infinite = Scan(np.full((9, 3), np.inf, np.float32), START_NS + 2, np.zeros(9, np.float32))
    empty = Scan(np.zeros((0, 3), np.float32), START_NS + 3, np.zeros(0, np.float32))
    snapshot = odd(tmp_path, [scan, zeros, infinite, empty])
    assert [len(scan.points_m) for scan in snapshot.lidars[0].scans] == [50, 0, 0, 0]
    assert snapshot.notes == ("'/a': 3 of 4 scans have no points, or only zeros.",)


def test_stamps_that_go_backward_are_told(tmp_path: Path) -> None:
    scans = list(make_snapshot(lidars=1).lidars[0].scans)
    assert odd(tmp_path, [scans[1], scans[0], scans[2]]).notes == (
        "'/a' has stamps that go backward; its scans were sorted.",
    )


def test_strict_takes_what_is_whole(tmp_path: Path) -> None:
    write_mcap(make_snapshot(), tmp_path / "a.mcap")
    config = IngestConfig(strict=True)
    assert len(read_snapshot(tmp_path / "a.mcap", config=config).lidars) == 2
    content = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "a.mcap").write_bytes(content[:-30])
    assert len(read_snapshot(tmp_path / "a.mcap").lidars) == 2
    with pytest.raises(UnreadableSourceError, match=r"strict is set: .* the file ends too early"):
        read_snapshot(tmp_path / "a.mcap", config=config)
    assert "strict is set" in inspect_source(tmp_path / "a.mcap", config=config).objection


def test_the_cloud_of_publish_is_no_lidar(tmp_path: Path) -> None:
    first, second, merged = make_snapshot(lidars=3, frames=1).lidars
    write_mcap(Snapshot((first, second, replace(merged, topic=MERGED_TOPIC))), tmp_path / "a.mcap")
    assert read_snapshot(tmp_path / "a.mcap").names == (first.name, second.name)
    assert read_snapshot(tmp_path / "a.mcap", config=IngestConfig(only=("/*",))).names == (first.name, second.name)
    chosen = IngestConfig(topics={"all": MERGED_TOPIC})
    assert read_snapshot(tmp_path / "a.mcap", config=chosen).names == ("all",)
    seen = inspect_source(tmp_path / "a.mcap").clouds
    assert [(cloud.topic, cloud.points_max) for cloud in seen if not cloud.frames_taken] == [(MERGED_TOPIC, 0)]
