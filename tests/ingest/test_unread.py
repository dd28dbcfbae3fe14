# SPDX-License-Identifier: Apache-2.0
"""Topics of points that nobody here reads are named, with what to do about them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from mcap.writer import Writer

from multilica.config import IngestConfig
from multilica.errors import UnfitSnapshotError
from multilica.ingest import read_snapshot
from multilica.ingest.snapshot_reader import listen
from tests.ingest.support.format_writers import livox_messages, write_raw_mcap
from tests.ingest.support.processes import served
from tests.ingest.support.recording_writers import START_NS, make_snapshot


@pytest.mark.parametrize(
    ("message_type", "driver"),
    [
        ("hesai_lidar/msg/PandarScan", "HesaiLidar_General_ROS"),
        ("hesai_ros_driver/msg/UdpFrame", "HesaiLidar_ROS_2.0"),
        ("pandar_msgs/msg/PandarScan", "nebula_ros, or pandar_pointcloud"),
        ("rslidar_msgs/msg/rslidarScan", "ros_rslidar"),
        ("nebula_msgs/msg/NebulaPackets", "nebula_ros"),
        ("rslidar_msg/msg/RslidarPacket", "rslidar_sdk"),
    ],
)
def test_packets_name_the_driver_to_run(tmp_path: Path, message_type: str, driver: str) -> None:
    write_raw_mcap(iter([("/packets", message_type, START_NS, b"\0" * 40)]), tmp_path / "a.mcap", "cdr")
    with pytest.raises(UnfitSnapshotError, match=f"'/packets' holds packets .*{driver}.*; replay the log through it"):
        read_snapshot(tmp_path / "a.mcap")


UNREAD = {
    "point_cloud_interfaces/msg/CompressedPointCloud2": "compressed clouds, .* republish of point_cloud_transport",
    "sensor_msgs/msg/PointCloud": "clouds of the old type .* point_cloud_converter turns into",
    "foxglove_msgs/msg/PointCloud": "clouds of the ROS type .*; record the sensor_msgs/msg/PointCloud2",
    "innovusion_msgs/msg/Packets": "packets of an unknown make; .* replay the log through its driver",
    "lslidar_msgs/msg/LslidarPacket": "packets of an unknown make",
    "draco_point_cloud_transport/msg/CompressedPointCloud2": "compressed clouds, .* republish of point_cloud_transport",
}


@pytest.mark.parametrize(
    "message_type",
    [
        "theora_image_transport/msg/Packet",
        "ffmpeg_image_transport_msgs/msg/FFMPEGPacket",
        "net/msg/PacketLossStatistics",
    ],
)
def test_packets_of_no_lidar_are_not_told(tmp_path: Path, message_type: str) -> None:
    path = tmp_path / "a.mcap"
    clouds = ("/front/points", "livox_ros_driver2/msg/CustomMsg", "cdr", _livox()[0][3])
    _write_mixed(path, [("/front/theora", message_type, "cdr", b"\0" * 40), clouds])
    assert read_snapshot(path).notes == ()


@pytest.mark.parametrize("message_type", UNREAD)
def test_clouds_of_types_that_are_not_read_are_told(tmp_path: Path, message_type: str) -> None:
    path, held = tmp_path / "a.mcap", f"'/roof' holds {UNREAD[message_type]}"
    roof = ("/roof", message_type, "cdr", b"\0" * 40)
    _write_mixed(path, [roof])
    with pytest.raises(UnfitSnapshotError, match=f"holds no point clouds that can be read: {held}"):
        read_snapshot(path)
    _write_mixed(path, [roof, ("/lidar_0/points", "livox_ros_driver2/msg/CustomMsg", "cdr", _livox()[0][3])])
    (note,) = read_snapshot(path).notes
    assert re.match(held, note)
    with pytest.raises(UnfitSnapshotError, match=f"In {re.escape(str(path))}, {held}"):
        read_snapshot(path, config=IngestConfig(only=("/roof", "/lidar_0/points")))


def test_compressed_copies_of_recorded_clouds_need_nothing(tmp_path: Path) -> None:
    known = [("/lidar_0/points", "livox_ros_driver2/msg/CustomMsg", "cdr", data) for _, _, _, data in _livox()]
    copy = ("/lidar_0/points/draco", "point_cloud_interfaces/msg/CompressedPointCloud2", "cdr", b"\0" * 40)
    _write_mixed(tmp_path / "a.mcap", [copy, *known])
    (note,) = read_snapshot(tmp_path / "a.mcap").notes
    assert note == "'/lidar_0/points/draco' holds compressed copies of clouds that are recorded, too, and are used."


def test_packets_of_several_lidars_are_one_note(tmp_path: Path) -> None:
    known = [("/lidar_0/points", "livox_ros_driver2/msg/CustomMsg", "cdr", data) for _, _, _, data in _livox()]
    packets = [(f"/lidar_{number}/packets", "nebula_msgs/msg/NebulaPackets", "cdr", b"\0" * 40) for number in (1, 2)]
    _write_mixed(tmp_path / "a.mcap", [*packets, *known])
    (note,) = read_snapshot(tmp_path / "a.mcap").notes
    assert note.startswith("'/lidar_1/packets', '/lidar_2/packets' hold packets of Autoware's Nebula driver")


def test_point_clouds_in_an_encoding_of_nobody_here_are_told(tmp_path: Path) -> None:
    path, held = tmp_path / "a.mcap", r"'/flat' holds foxglove.PointCloud in the encoding 'flatbuffer'; expected "
    known = [("/lidar_0/points", "livox_ros_driver2/msg/CustomMsg", "cdr", data) for _, _, _, data in _livox()]
    _write_mixed(path, [("/flat", "foxglove.PointCloud", "flatbuffer", b"\0" * 40)])
    with pytest.raises(UnfitSnapshotError, match=f"holds no point clouds that can be read: {held}protobuf or json"):
        read_snapshot(path)
    _write_mixed(path, [("/flat", "foxglove.PointCloud", "flatbuffer", b"\0" * 40), *known])
    (note,) = read_snapshot(path).notes
    assert re.match(held, note)
    with pytest.raises(UnfitSnapshotError, match=f"In {re.escape(str(path))}, {held}"):
        read_snapshot(path, config=IngestConfig(topics={"flat": "/flat"}))


@pytest.mark.slow
def test_a_running_vehicle_is_told_the_same() -> None:
    with served("bridge_server.py", "flatbuffer", 0, "none") as port:
        config = IngestConfig(frames=1, timeout_s=1.0)
        with pytest.raises(UnfitSnapshotError, match=r"in the encoding 'flatbuffer'; expected protobuf or json"):
            listen(f"ws://127.0.0.1:{port}", config=config)


def _livox() -> list[tuple[str, str, int, bytes]]:
    return list(livox_messages(make_snapshot(lidars=1), "livox_ros_driver2", "cdr"))


def _write_mixed(path: Path, messages: list[tuple[str, str, str, bytes]]) -> None:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("", "test")
        for number, (topic, message_type, encoding, data) in enumerate(messages):
            schema = writer.register_schema(message_type, "", b"")
            channel = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, START_NS + number, data, START_NS + number)
        writer.finish()
