# SPDX-License-Identifier: Apache-2.0
"""Every format gives the same snapshot."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import Channel, Message, Schema, Statistics
from mcap.writer import CompressionType, Writer
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import CompressionMode, StoragePlugin

from multilica.config import IngestConfig
from multilica.geometry import RigidTransform
from multilica.ingest import read_snapshot
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica.snapshot import Snapshot
from tests.ingest.support import recording_writers
from tests.ingest.support.format_writers import POINT_WRITERS
from tests.ingest.support.recording_writers import (
    assert_same_points,
    assert_same_times,
    make_snapshot,
    write_mcap,
    write_mcap_ros2,
    write_ros1_bag,
    write_ros2_bag,
)

MCAP_VARIANTS = {
    "zstd": {},
    "lz4": {"compression": CompressionType.LZ4},
    "uncompressed": {"compression": CompressionType.NONE},
    "unindexed": {"indexed": False},
    "unchunked": {"chunked": False},
    "one_chunk": {"chunk_size": 1 << 24},
    "ros1": {"encoding": "ros1"},
    "ros1_unindexed": {"encoding": "ros1", "indexed": False},
}
LZ4, BZ2 = Ros1Writer.CompressionFormat.LZ4, Ros1Writer.CompressionFormat.BZ2


class WithoutCounts(Statistics):
    """Statistics that leave out the number of messages of each channel."""

    def write(self, builder: RecordBuilder) -> None:
        self.channel_message_counts = {}
        super().write(builder)


def test_an_index_may_leave_out_what_the_format_allows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    snapshot, path = make_snapshot(), tmp_path / "a.mcap"
    for left_out in ({"repeat_channels": False}, {"repeat_schemas": False}, {"use_statistics": False}):
        with monkeypatch.context() as patch:
            patch.setattr(recording_writers, "McapWriter", partial(Writer, **left_out))
            write_mcap(snapshot, path)
        assert_same_points(read_snapshot(path), snapshot)
    monkeypatch.setattr("mcap.writer.Statistics", WithoutCounts)
    write_mcap(snapshot, path)
    assert_same_points(read_snapshot(path), snapshot)


def test_messages_may_lie_beside_the_chunks(tmp_path: Path) -> None:
    snapshot, path = make_snapshot(), tmp_path / "a.mcap"
    write_mcap(snapshot, path)
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
        messages = [(channel.topic, message) for _, channel, message in make_reader(file).iter_messages()]
    beside = messages[-1][0]
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 24)
        writer.start("ros2", "test")
        alone = RecordBuilder()
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            channel_id = writer.register_channel(channel.topic, channel.message_encoding, number)
            for topic, message in messages:
                if topic != channel.topic:
                    continue
                if topic != beside:
                    writer.add_message(channel_id, message.log_time, message.data, message.publish_time)
                    continue
                Schema(id=number, name=schema.name, encoding=schema.encoding, data=schema.data).write(alone)
                Channel(channel_id, topic, channel.message_encoding, {}, number).write(alone)
                Message(channel_id, message.log_time, message.data, message.publish_time, 0).write(alone)
                statistics = writer._Writer__statistics
                statistics.message_count += 1
                statistics.channel_message_counts[channel_id] = statistics.channel_message_counts.get(channel_id, 0) + 1
        file.write(alone.end())
        writer.finish()
    found = read_snapshot(path)
    assert_same_points(found, snapshot)


def test_recordings_give_what_was_written(tmp_path: Path) -> None:
    snapshot = make_snapshot()
    writers: dict[str, Callable[[Path], None]] = {
        "by_multilica.mcap": lambda path: write_snapshot_mcap(snapshot, path),
        "by_mcap_ros2.mcap": lambda path: write_mcap_ros2(snapshot, path),
        "plain.bag": lambda path: write_ros1_bag(snapshot, path),
        "lz4.bag": lambda path: write_ros1_bag(snapshot, path, LZ4),
        "bz2.bag": lambda path: write_ros1_bag(snapshot, path, BZ2),
        "ros2_sqlite3": lambda path: write_ros2_bag(snapshot, path),
        "ros2_mcap": lambda path: write_ros2_bag(snapshot, path, StoragePlugin.MCAP),
        "ros2_messages": lambda path: write_ros2_bag(snapshot, path, compression=CompressionMode.MESSAGE),
        "ros2_storage": lambda path: write_ros2_bag(snapshot, path, StoragePlugin.MCAP, CompressionMode.STORAGE),
    }
    for name, write in writers.items():
        write(tmp_path / name)
        found = read_snapshot(tmp_path / name)
        assert found.notes == (), name
        assert_same_points(found, snapshot)
        assert_same_times(found, snapshot)


@pytest.mark.parametrize("variant", MCAP_VARIANTS)
def test_mcap_in_every_shape(tmp_path: Path, variant: str) -> None:
    snapshot = make_snapshot()
    write_mcap(snapshot, tmp_path / "a.mcap", **MCAP_VARIANTS[variant])
    found = read_snapshot(tmp_path / "a.mcap")
    assert found.notes == ()
    assert_same_points(found, snapshot)
    assert_same_times(found, snapshot)


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_bare_storage_file_of_a_ros2_bag(tmp_path: Path, storage: StoragePlugin) -> None:
    snapshot = make_snapshot()
    write_ros2_bag(snapshot, tmp_path / "bag", storage)
    (bare,) = [path for path in (tmp_path / "bag").iterdir() if path.suffix in {".db3", ".mcap"}]
    assert_same_points(read_snapshot(bare), snapshot)


def test_recording_without_suffix_is_known_by_its_content(tmp_path: Path) -> None:
    snapshot = make_snapshot()
    write_mcap(snapshot, tmp_path / "recording")
    assert_same_points(read_snapshot(tmp_path / "recording"), snapshot)


@pytest.mark.parametrize("storage", [StoragePlugin.SQLITE3, StoragePlugin.MCAP])
def test_split_bag_whose_recorder_died(tmp_path: Path, storage: StoragePlugin) -> None:
    snapshot = make_snapshot(frames=4)
    for part in range(2):
        half = Snapshot(
            tuple(
                type(lidar)(lidar.name, lidar.scans[2 * part : 2 * part + 2], lidar.frame_id, lidar.topic)
                for lidar in snapshot.lidars
            )
        )
        write_ros2_bag(half, tmp_path / f"part{part}", storage)
        (stored,) = [path for path in (tmp_path / f"part{part}").iterdir() if path.suffix in {".db3", ".mcap"}]
        (tmp_path / "bag").mkdir(exist_ok=True)
        stored.rename(tmp_path / "bag" / f"log_{part}{stored.suffix}")
    found = read_snapshot(tmp_path / "bag")
    assert_same_points(found, snapshot)
    assert_same_times(found, snapshot)


@pytest.mark.parametrize("name", ["a.mcap", "a.bag", "bag"])
def test_static_transforms_are_kept(tmp_path: Path, name: str) -> None:
    bare = make_snapshot()
    poses = (
        RigidTransform.from_xyz_rpy("base_link", "lidar_0", [1.0, 2.0, 3.0], [0.1, -0.2, 0.3]),
        RigidTransform.from_xyz_rpy("base_link", "lidar_1", [-1.0, 0.0, 0.5], [0.0, 0.0, 3.1]),
    )
    snapshot = Snapshot(bare.lidars, static_transforms=poses)
    write = {"a.mcap": write_mcap, "a.bag": write_ros1_bag, "bag": write_ros2_bag}[name]
    write(snapshot, tmp_path / name)
    found = read_snapshot(tmp_path / name).static_transforms
    assert [(pose.target, pose.source) for pose in found] == [("base_link", "lidar_0"), ("base_link", "lidar_1")]
    for pose, expected in zip(found, poses, strict=True):
        np.testing.assert_allclose(pose.matrix, expected.matrix, atol=1e-12)


def test_snapshot_file_keeps_names_frames_and_transforms(tmp_path: Path) -> None:
    write_mcap(make_snapshot(), tmp_path / "log.mcap")
    topics = {"roof": "/lidar_1/points", "front": "/lidar_0/points"}
    snapshot = read_snapshot(tmp_path / "log.mcap", config=IngestConfig(topics=topics))
    pose = RigidTransform.from_xyz_rpy("base_link", "lidar_0", [1.0, 2.0, 3.0], [0.1, -0.2, 0.3])
    snapshot = Snapshot(snapshot.lidars, static_transforms=(pose,))
    write_snapshot_mcap(snapshot, tmp_path / "snapshot.mcap")
    found = read_snapshot(tmp_path / "snapshot.mcap")
    assert found.names == ("front", "roof")
    assert_same_points(found, snapshot)
    assert_same_times(found, snapshot)
    np.testing.assert_allclose(found.static_transforms[0].matrix, pose.matrix, atol=1e-12)


def test_files_of_nuscenes_have_a_suffix_of_two_parts(tmp_path: Path) -> None:
    scan = make_snapshot(lidars=1, frames=1).lidars[0].scans[0]
    for name in ("rear", "top"):
        POINT_WRITERS["a.pcd.bin"](scan, tmp_path / f"{name}.pcd.bin")
    assert read_snapshot(tmp_path).names == read_snapshot(sorted(tmp_path.iterdir())).names == ("rear", "top")
