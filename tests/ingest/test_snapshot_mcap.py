# SPDX-License-Identifier: Apache-2.0
"""The snapshot file as readers of other makes see it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

from multilica.geometry import RigidTransform
from multilica.pointcloud2 import LIDAR_NAME_KEY, SNAPSHOT_METADATA_NAME
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica.snapshot import LidarScans, Scan, Snapshot
from tests.ingest.support.recording_writers import START_NS, make_snapshot


@pytest.fixture
def snapshot() -> Snapshot:
    pose = RigidTransform.from_xyz_rpy("base", "lidar_1", [1.0, 2.0, 3.0], [0.1, 0.2, 0.3])
    return Snapshot(make_snapshot().lidars, source="log.bag", source_sha256="abc", static_transforms=(pose,))


def test_it_is_indexed_compressed_and_checked(tmp_path: Path, snapshot: Snapshot) -> None:
    path = tmp_path / "a.mcap"
    write_snapshot_mcap(snapshot, path, metadata={"seed": "7"})
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
        (metadata,) = reader.iter_metadata()
    assert {index.compression for index in summary.chunk_indexes} == {"zstd"}
    assert summary.statistics.message_count == 7
    assert {channel.metadata.get(LIDAR_NAME_KEY) for channel in summary.channels.values()} == {None, *snapshot.names}
    assert metadata.name == SNAPSHOT_METADATA_NAME
    assert metadata.metadata["source_sha256"] == "abc"
    assert metadata.metadata["seed"] == "7"
    with path.open("rb") as file:
        assert len(list(NonSeekingReader(file, validate_crcs=True).iter_messages())) == 7
    assert list(tmp_path.iterdir()) == [path]


def test_chunks_have_checksums_and_late_subscribers_transforms(tmp_path: Path, snapshot: Snapshot) -> None:
    write_snapshot_mcap(snapshot, tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        chunks = [each for each in StreamReader(file, emit_chunks=True).records if isinstance(each, Chunk)]
    assert chunks
    assert all(chunk.uncompressed_crc for chunk in chunks)
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        (durability,) = {
            each.ext.offered_qos_profiles[0].durability for each in reader.topics["/tf_static"].connections
        }
    assert durability is QosDurability.TRANSIENT_LOCAL


def test_mcap_ros2_decodes_it(tmp_path: Path, snapshot: Snapshot) -> None:
    write_snapshot_mcap(snapshot, tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as file:
        decoded = list(make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages())
    clouds = [entry.decoded_message for entry in decoded if entry.schema.name == "sensor_msgs/msg/PointCloud2"]
    first = np.frombuffer(bytes(clouds[0].data), np.float32).reshape(-1, 4)
    np.testing.assert_array_equal(first[:, :3], snapshot.lidars[0].scans[0].points_m)
    np.testing.assert_array_equal(first[:, 3], snapshot.lidars[0].scans[0].intensity)
    assert (clouds[0].header.stamp.sec * 10**9 + clouds[0].header.stamp.nanosec) == START_NS
    transform = decoded[0].decoded_message.transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("base", "lidar_1")
    assert transform.transform.translation.y == 2.0


def test_rosbags_decodes_it(tmp_path: Path, snapshot: Snapshot) -> None:
    write_snapshot_mcap(snapshot, tmp_path / "a.mcap")
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        assert sorted(reader.topics) == ["/lidar_0/points", "/lidar_1/points", "/tf_static"]
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/lidar_1/points":
                assert message.header.frame_id == "lidar_1"
                assert message.width * message.point_step == message.row_step == len(message.data)


def test_the_same_snapshot_gives_the_same_bytes(tmp_path: Path, snapshot: Snapshot) -> None:
    write_snapshot_mcap(snapshot, tmp_path / "a.mcap")
    write_snapshot_mcap(snapshot, tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


def test_clouds_of_files_get_a_topic_and_need_no_intensity(tmp_path: Path) -> None:
    scan = Scan(np.ones((4, 3), np.float32))
    write_snapshot_mcap(Snapshot((LidarScans("roof", (scan,), topic="roof.pcd"),)), tmp_path / "a.mcap")
    with AnyReader([tmp_path / "a.mcap"]) as reader:
        ((connection, log_time, data),) = reader.messages()
        assert (connection.topic, log_time) == ("/roof/points", 0)
        assert [field.name for field in reader.deserialize(data, connection.msgtype).fields] == ["x", "y", "z"]


def test_a_failed_write_leaves_nothing(tmp_path: Path) -> None:
    scan = Scan(np.ones((4, 3), np.float32), stamp_ns=START_NS)
    with pytest.raises(UnicodeEncodeError):
        write_snapshot_mcap(Snapshot((LidarScans("a", (scan,), frame_id="\ud800"),)), tmp_path / "a.mcap")
    assert list(tmp_path.iterdir()) == []
