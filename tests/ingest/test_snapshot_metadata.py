# SPDX-License-Identifier: Apache-2.0
"""A recorded snapshot stands in for its source."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

import multilica
from multilica import read_snapshot
from multilica.config import CalibrationConfig, IngestConfig, with_overrides
from multilica.errors import UnreadableSourceError
from multilica.geometry import RigidTransform
from multilica.ingest import frames_recorded, inspect_source
from multilica.pointcloud2 import SNAPSHOT_METADATA_NAME
from multilica.sinks.snapshots import window_metadata, write_snapshot_mcap
from multilica.snapshot import Snapshot
from multilica_cli.commands.calibrate import find_sample
from tests.ingest.support.recording_writers import (
    CLOUD,
    START_NS,
    assert_same_points,
    assert_same_times,
    cloud_message,
    make_snapshot,
    ros2_types,
    write_mcap,
    write_ros1_bag,
    write_ros2_bag,
)

POSE = RigidTransform.from_xyz_rpy("base", "lidar_1", [1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
WRITERS: dict[str, Callable[[Snapshot, Path], None]] = {
    "drive.mcap": write_mcap,
    "drive.bag": write_ros1_bag,
    "drive": write_ros2_bag,
    "ros1.mcap": lambda snapshot, path: write_mcap(snapshot, path, encoding="ros1"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_the_recorded_snapshot_reads_like_its_log(name: str, tmp_path: Path) -> None:
    log, recorded = tmp_path / name, tmp_path / "snapshot.mcap"
    WRITERS[name](Snapshot(make_snapshot(lidars=3, frames=8).lidars, static_transforms=(POSE,)), log)
    config = IngestConfig(frames=4, start_s=0.2, topics={"roof": "/lidar_2/points", "lidar_0": "/lidar_0/points"})
    taken = read_snapshot(log, config=config)
    write_snapshot_mcap(taken, recorded)
    found = read_snapshot(recorded)
    assert [len(lidar.scans) for lidar in found.lidars] == [4, 4]
    assert_same_points(found, taken)
    assert_same_times(found, taken)
    (pose,) = found.static_transforms
    assert (pose.target, pose.source) == ("base", "lidar_1")
    np.testing.assert_allclose(pose.matrix, POSE.matrix, atol=1e-12)


def test_point_files_become_topics(tmp_path: Path) -> None:
    folder = tmp_path / "scans"
    points = np.random.default_rng(0).normal(0.0, 9.0, (20, 3)).astype(np.float32)
    for name in ("left", "right"):
        path = folder / f"{name}.pcd"
        path.parent.mkdir(exist_ok=True)
        header = "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 20\nHEIGHT 1\nPOINTS 20\n"
        path.write_bytes(header.encode() + b"DATA binary\n" + points.tobytes())
    write_snapshot_mcap(read_snapshot(folder), tmp_path / "snapshot.mcap")
    found = read_snapshot(tmp_path / "snapshot.mcap")
    assert [(lidar.name, lidar.frame_id, lidar.topic) for lidar in found.lidars] == [
        ("left", "left", "/left/points"),
        ("right", "right", "/right/points"),
    ]
    for lidar in found.lidars:
        np.testing.assert_array_equal(lidar.scans[0].points_m, points)
        assert lidar.scans[0].intensity is None


@pytest.mark.slow
@pytest.mark.in_turn
def test_calibration_on_the_snapshot_is_that_on_the_log(tmp_path: Path) -> None:
    config = with_overrides(CalibrationConfig(), ["until=refine", "coarse.max_hypotheses=4", "fine.max_finalists=2"])
    config = config.model_copy(
        update={"ingest": IngestConfig(frames=1, topics={name: f"/lidar/{name}/points" for name in ("front", "right")})}
    )
    log = read_snapshot(find_sample().recording, config=config.ingest)
    write_snapshot_mcap(log, tmp_path / "snapshot.mcap")
    found = multilica.calibrate(read_snapshot(tmp_path / "snapshot.mcap"), config)
    expected = multilica.calibrate(log, config)
    assert expected.status == found.status == "complete"
    assert found.target == expected.target
    for ours, theirs in zip(found.placements, expected.placements, strict=True):
        np.testing.assert_array_equal(ours.T_target_source.matrix, theirs.T_target_source.matrix)
        assert ours.fitness == theirs.fitness


def test_the_file_says_where_it_comes_from(tmp_path: Path) -> None:
    write_mcap(make_snapshot(), tmp_path / "drive.mcap")
    config = IngestConfig(frames=2, start_s=0.1)
    taken = read_snapshot(tmp_path / "drive.mcap", config=config)
    write_snapshot_mcap(taken, tmp_path / "a.mcap", metadata=window_metadata(config, "bus-7"))
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file)
        (record,) = reader.iter_metadata()
        channels = reader.get_summary().channels.values()
    assert record.name == SNAPSHOT_METADATA_NAME
    stamps = [scan.stamp_ns for lidar in taken.lidars for scan in lidar.scans]
    assert record.metadata == {
        "lidars": "lidar_0, lidar_1",
        "source": "drive.mcap",
        "source_sha256": taken.source_sha256,
        "first_stamp_ns": str(min(stamps)),
        "last_stamp_ns": str(max(stamps)),
        "notes": json.dumps(taken.notes),
        "version": multilica.__version__,
        "frames": "2",
        "start_s": "0.1",
        "start_at": "",
        "window": "start",
        "window_s": "0",
        "vehicle": "bus-7",
    }
    assert all("durability: 2" in channel.metadata["offered_qos_profiles"] for channel in channels)


def test_a_recorded_snapshot_is_taken_whole(tmp_path: Path) -> None:
    log, recorded, shorter = tmp_path / "drive.mcap", tmp_path / "a.mcap", tmp_path / "b.mcap"
    write_mcap(make_snapshot(frames=30), log)
    for path, frames in ((recorded, 24), (shorter, 12)):
        config = IngestConfig(frames=frames)
        write_snapshot_mcap(read_snapshot(log, config=config), path, metadata=window_metadata(config))
    assert [len(lidar.scans) for lidar in read_snapshot(recorded).lidars] == [24, 24]
    assert [len(lidar.scans) for lidar in read_snapshot(recorded, config=IngestConfig()).lidars] == [10, 10]
    assert [len(lidar.scans) for lidar in read_snapshot(log).lidars] == [10, 10]
    assert inspect_source(recorded).clouds[0].frames_taken == 24
    assert frames_recorded([recorded, shorter]) == 24
    assert [frames_recorded(paths) for paths in ([recorded, log], [log], [])] == [None, None, None]


def test_a_damaged_recorded_snapshot_is_read_like_a_log(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    config = IngestConfig(frames=12)
    write_snapshot_mcap(make_snapshot(frames=12), path, metadata=window_metadata(config))
    assert frames_recorded([path]) == 12
    content = path.read_bytes()
    for size in (0, 5, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:size])
        assert frames_recorded([path]) is None
    for metadata in ({"frames": "all"}, {"frames": ""}, {}):
        write_snapshot_mcap(make_snapshot(), path, metadata=metadata)
        assert frames_recorded([path]) is None


def test_lidars_with_clocks_of_their_own_stay_together(tmp_path: Path) -> None:
    store, messages = ros2_types(), []
    for lidar, behind_ns in zip(
        make_snapshot(lidars=3, frames=15).lidars, (0, 37 * 10**9, START_NS - 10**9), strict=True
    ):
        for scan in lidar.scans:
            late = replace(scan, stamp_ns=scan.stamp_ns - behind_ns)
            cloud = cloud_message(store, late, lidar.name)
            messages.append((lidar.topic, CLOUD, scan.stamp_ns, bytes(store.serialize_cdr(cloud, CLOUD))))
    log, recorded = tmp_path / "drive.mcap", tmp_path / "a.mcap"
    write_mcap(Snapshot(()), log, messages=sorted(messages, key=lambda message: message[2]))
    taken = read_snapshot(log, config=IngestConfig(frames=12))
    write_snapshot_mcap(taken, recorded)
    for config in (IngestConfig(frames=12), IngestConfig(frames=5, start_s=0.3), IngestConfig(frames=3, window_s=1.0)):
        found, expected = read_snapshot(recorded, config=config), read_snapshot(log, config=config)
        assert_same_points(found, expected)
        assert_same_times(found, expected)
        assert found.notes == expected.notes
        assert any(note.startswith("The stamps lag behind the log time") for note in found.notes)
    assert inspect_source(recorded).duration_s == pytest.approx(1.1, abs=1e-3)


def test_what_was_noticed_when_it_was_recorded_is_told_again(tmp_path: Path) -> None:
    log, recorded, again = (tmp_path / name for name in ("drive.mcap", "a.mcap", "b.mcap"))
    write_mcap(make_snapshot(frames=8), log)
    log.write_bytes(log.read_bytes()[: log.stat().st_size // 2])
    taken = read_snapshot(log)
    assert any(note.endswith("of 10 scans, then the file ends too early.") for note in taken.notes)
    write_snapshot_mcap(taken, recorded)
    own = "'/lidar_1/points' has 4 scans in the window, others have more."
    expected = (own, *(f"When it was recorded: {note}" for note in taken.notes))
    assert read_snapshot(recorded).notes == inspect_source(recorded).notes == expected
    write_snapshot_mcap(read_snapshot(recorded), again)
    assert read_snapshot(again).notes == expected
    for notes in ("no list", "[" * 9000, "{}", "[1, [2]]"):
        write_snapshot_mcap(taken, recorded, metadata={"notes": notes})
        assert read_snapshot(recorded).notes == (own,)


def test_what_may_not_be_looked_at_is_left_to_who_reads_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path) -> bool:
        raise PermissionError(13, "Permission denied", str(path))

    monkeypatch.setattr(Path, "exists", refuse)
    assert frames_recorded([tmp_path / "a.mcap"]) is None
    with pytest.raises(UnreadableSourceError, match=r"a\.mcap cannot be opened: Permission denied"):
        read_snapshot(tmp_path / "a.mcap")


@pytest.mark.parametrize("log_time_ns", [0, 2**63, 2**64 - 10**9])
@pytest.mark.parametrize("stamp_ns", [1, -(10**9), START_NS, 2**31 * 10**9, 2**64])
def test_times_that_ros_cannot_hold_cost_no_points(tmp_path: Path, log_time_ns: int, stamp_ns: int) -> None:
    taken = Snapshot(
        tuple(
            replace(
                lidar,
                scans=tuple(
                    replace(scan, stamp_ns=stamp_ns + number * 1000, log_time_ns=log_time_ns + number * 1000)
                    for number, scan in enumerate(lidar.scans)
                ),
            )
            for lidar in make_snapshot().lidars
        ),
        static_transforms=(POSE,),
    )
    write_snapshot_mcap(taken, tmp_path / "a.mcap")
    found = read_snapshot(tmp_path / "a.mcap")
    assert_same_points(found, taken)
    assert len(found.static_transforms) == 1
    spans_ns = [lidar.scans[-1].log_time_ns - lidar.scans[0].log_time_ns for lidar in found.lidars]
    assert spans_ns == [2000, 2000]
