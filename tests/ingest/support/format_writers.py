# SPDX-License-Identifier: Apache-2.0
"""Snapshots in the formats of other makes: Foxglove, Livox, Velodyne, surveyors, NumPy."""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import foxglove
import foxglove.messages as fox
import laspy
import numpy as np
from mcap.writer import CompressionType, Writer
from mcap_ros1.writer import Writer as McapRos1Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from multilica.snapshot import Scan, Snapshot
from tests.ingest.support.recording_writers import CLOUD, cloud_message, header, in_order, rings_of, ros1_types

LIVOX_DRIVERS = ("livox_ros_driver", "livox_ros_driver2")
LIVOX_POINT_NS = 100_000
_LIVOX_POINT = "uint32 offset_time\nfloat32 x\nfloat32 y\nfloat32 z\nuint8 reflectivity\nuint8 tag\nuint8 line"
_LIVOX_SCAN = (
    "std_msgs/Header header\nuint64 timebase\nuint32 point_num\nuint8 lidar_id\nuint8[3] rsvd\n{}/CustomPoint[] points"
)
FLOAT32 = fox.PackedElementFieldNumericType.Float32


def packed(scan: Scan) -> bytes:
    """x, y, z, intensity as little-endian float32."""
    columns = [scan.points_m, np.zeros((len(scan.points_m), 1)) if scan.intensity is None else scan.intensity[:, None]]
    return np.hstack(columns).astype("<f4").tobytes()


def write_foxglove_sdk(snapshot: Snapshot, path: Path) -> None:
    """By Foxglove's own SDK, protocol buffers."""
    context = foxglove.Context()
    with foxglove.open_mcap(path, context=context):
        channels: dict[str, Any] = {}
        for lidar, scan in in_order(snapshot):
            if lidar.topic not in channels:
                channels[lidar.topic] = foxglove.channels.PointCloudChannel(lidar.topic, context=context)
            channels[lidar.topic].log(foxglove_cloud(scan, lidar.frame_id), log_time=scan.stamp_ns)


def foxglove_cloud(scan: Scan, frame_id: str, pose: fox.Pose | None = None) -> fox.PointCloud:
    names = ("x", "y", "z", "intensity")
    return fox.PointCloud(
        timestamp=fox.Timestamp(scan.stamp_ns // 10**9, scan.stamp_ns % 10**9),
        frame_id=frame_id,
        pose=pose,
        point_stride=16,
        fields=[fox.PackedElementField(name=name, offset=4 * at, type=FLOAT32) for at, name in enumerate(names)],
        data=packed(scan),
    )


def write_foxglove_json(
    snapshot: Snapshot, path: Path, compression: CompressionType = CompressionType.LZ4, **changes: object
) -> None:
    """`changes` replace keys of each message; None removes one."""
    with path.open("wb") as file:
        writer = Writer(file, compression=compression)
        writer.start()
        schema = writer.register_schema("foxglove.PointCloud", "jsonschema", b"{}")
        channels: dict[str, int] = {}
        for lidar, scan in in_order(snapshot):
            if lidar.topic not in channels:
                channels[lidar.topic] = writer.register_channel(lidar.topic, "json", schema)
            table = {**json_cloud(scan, lidar.frame_id), **changes}
            data = json.dumps({key: value for key, value in table.items() if value is not None})
            writer.add_message(channels[lidar.topic], scan.stamp_ns, data.encode(), scan.stamp_ns)
        writer.finish()


def json_cloud(scan: Scan, frame_id: str) -> dict[str, Any]:
    return {
        "timestamp": {"sec": scan.stamp_ns // 10**9, "nsec": scan.stamp_ns % 10**9},
        "frame_id": frame_id,
        "pose": {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
        "point_stride": 16,
        "fields": [{"name": name, "offset": 4 * at, "type": 7} for at, name in enumerate(("x", "y", "z", "intensity"))],
        "data": base64.b64encode(packed(scan)).decode(),
    }


def write_mcap_ros1(snapshot: Snapshot, path: Path) -> None:
    """By the `mcap_ros1` package, bytes of `rosbags`."""
    store = ros1_types()
    definition, md5sum = store.generate_msgdef(CLOUD, ros_version=1)

    class Bytes:
        """As `genpy` would make it."""

        _full_text, _md5sum, _type = definition, md5sum, "sensor_msgs/PointCloud2"

        def __init__(self, data: bytes) -> None:
            self.data = data

        def serialize(self, buffer: Any) -> None:
            buffer.write(self.data)

    with path.open("wb") as file:
        writer = McapRos1Writer(file, chunk_size=4096)
        for lidar, scan in in_order(snapshot):
            data = bytes(store.serialize_ros1(cloud_message(store, scan, lidar.frame_id), CLOUD))
            writer.write_message(lidar.topic, Bytes(data), log_time=scan.stamp_ns, publish_time=scan.stamp_ns)
        writer.finish()


@cache
def livox_types(driver: str, encoding: str) -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(_LIVOX_POINT, f"{driver}/msg/CustomPoint"))
    store.register(get_types_from_msg(_LIVOX_SCAN.format(driver), f"{driver}/msg/CustomMsg"))
    return store


def livox_messages(snapshot: Snapshot, driver: str, encoding: str) -> Iterator[tuple[str, str, int, bytes]]:
    """Serialised point by point by `rosbags`; intensities as whole numbers."""
    store = livox_types(driver, encoding)
    point = store.types[f"{driver}/msg/CustomPoint"]
    message_type = f"{driver}/msg/CustomMsg"
    serialise = store.serialize_ros1 if encoding == "ros1" else store.serialize_cdr
    for lidar, scan in in_order(snapshot):
        message = store.types[message_type](
            header=header(store, lidar.frame_id, scan.stamp_ns),
            timebase=scan.stamp_ns,
            point_num=len(scan.points_m),
            lidar_id=1,
            rsvd=np.zeros(3, np.uint8),
            points=[
                point(LIVOX_POINT_NS * index, *map(float, xyz), int(value), 16, index % 16)
                for index, (xyz, value) in enumerate(zip(scan.points_m, scan.intensity, strict=True))
            ],
        )
        yield lidar.topic, message_type, scan.stamp_ns, bytes(serialise(message, message_type))


def write_raw_mcap(messages: Iterator[tuple[str, str, int, bytes]], path: Path, encoding: str) -> None:
    """Messages (topic, type, log time, bytes) without definitions, which no reader here needs."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2048)
        writer.start()
        channels: dict[str, int] = {}
        for topic, message_type, log_time, data in messages:
            if topic not in channels:
                schema = writer.register_schema(message_type, "", b"")
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], log_time, data, log_time)
        writer.finish()


def velodyne_messages(encoding: str, range_m: float = 10.0, model: int = 0x22) -> Iterator[tuple[str, str, int, bytes]]:
    """A turn of a VLP-16, or of another model by its number, that sees a sphere around itself."""
    store = velodyne_types(encoding)
    packet = store.types["velodyne_msgs/msg/VelodynePacket"]
    time = store.types["builtin_interfaces/msg/Time"](sec=1700, nanosec=0)
    serialise = store.serialize_ros1 if encoding == "ros1" else store.serialize_cdr
    message_type = "velodyne_msgs/msg/VelodyneScan"
    packets = [packet(time, np.frombuffer(velodyne_packet(start, range_m, model), np.uint8)) for start in range(75)]
    scan = store.types[message_type](header(store, "velodyne", 1700 * 10**9), packets)
    yield "/velodyne_packets", message_type, 1700 * 10**9, bytes(serialise(scan, message_type))


def velodyne_packet(number: int, range_m: float, model: int) -> bytes:
    """Twelve blocks of 32 returns, the strongest each, 0.4 degrees apart; two firings of the VLP-16, one of others."""
    returns = struct.pack("<HB", round(range_m / (0.004 if model == 0x28 else 0.002)), 100) * 32
    blocks = b"".join(
        b"\xff\xee" + struct.pack("<H", (480 * number + 40 * block) % 36000) + returns for block in range(12)
    )
    return blocks + struct.pack("<IBB", number * 1330, 0x37, model)


@cache
def velodyne_types(encoding: str) -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    time = "time" if encoding == "ros1" else "builtin_interfaces/Time"
    store.register(get_types_from_msg(f"{time} stamp\nuint8[1206] data", "velodyne_msgs/msg/VelodynePacket"))
    scan = "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets"
    store.register(get_types_from_msg(scan, "velodyne_msgs/msg/VelodyneScan"))
    return store


def write_las(scan: Scan, path: Path, version: str = "1.2", point_format: int = 0) -> None:
    """By `laspy`, on a grid of a tenth of a millimetre; compressed where the name ends with ``.laz``."""
    las = laspy.LasData(laspy.LasHeader(version=version, point_format=point_format))
    las.header.scales, las.header.offsets = np.full(3, 1e-4), np.array([1.0, 2.0, 3.0])
    las.x, las.y, las.z = scan.points_m.T.astype(np.float64)
    if scan.intensity is not None:
        las.intensity = scan.intensity.astype(np.uint16)
    las.write(path)


def write_npy(scan: Scan, path: Path) -> None:
    np.save(path, np.hstack([scan.points_m, scan.intensity[:, None]]))


def write_kitti(scan: Scan, path: Path) -> None:
    path.write_bytes(packed(scan))


def write_nuscenes(scan: Scan, path: Path) -> None:
    ring = rings_of(scan)[:, None]
    path.write_bytes(np.hstack([scan.points_m, scan.intensity[:, None], ring]).astype("<f4").tobytes())


POINT_WRITERS: dict[str, Callable[[Scan, Path], None]] = {
    "a.las": write_las,
    "a.laz": write_las,
    "b.las": lambda scan, path: write_las(scan, path, "1.4", 6),
    "b.laz": lambda scan, path: write_las(scan, path, "1.4", 6),
    "a.npy": write_npy,
    "a.bin": write_kitti,
    "a.pcd.bin": write_nuscenes,
}
