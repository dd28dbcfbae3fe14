# SPDX-License-Identifier: Apache-2.0
"""The same snapshot written by the writers of other makes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, IndexType
from mcap.writer import Writer as McapWriter
from mcap_ros2.writer import Writer as McapRos2Writer
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2.storage_sqlite3 import Sqlite3Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from multilica.snapshot import LidarScans, Scan, Snapshot

CLOUD = "sensor_msgs/msg/PointCloud2"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000


def make_snapshot(lidars: int = 2, frames: int = 3, points: int = 50, seed: int = 0) -> Snapshot:
    rng = np.random.default_rng(seed)
    return Snapshot(
        tuple(
            LidarScans(
                f"lidar_{index}",
                tuple(
                    Scan(
                        rng.normal(0.0, 20.0, (points + frame, 3)).astype(np.float32),
                        START_NS + frame * PERIOD_NS + index * 1000,
                        rng.uniform(0.0, 255.0, points + frame).astype(np.float32),
                    )
                    for frame in range(frames)
                ),
                frame_id=f"lidar_{index}",
                topic=f"/lidar_{index}/points",
            )
            for index in range(lidars)
        )
    )


def assert_same_points(found: Snapshot, expected: Snapshot) -> None:
    assert found.names == expected.names
    for ours, theirs in zip(found.lidars, expected.lidars, strict=True):
        assert len(ours.scans) == len(theirs.scans)
        for scan, other in zip(ours.scans, theirs.scans, strict=True):
            np.testing.assert_array_equal(scan.points_m, other.points_m)
            np.testing.assert_array_equal(scan.intensity, other.intensity)


def assert_same_times(found: Snapshot, expected: Snapshot) -> None:
    for ours, theirs in zip(found.lidars, expected.lidars, strict=True):
        assert [scan.stamp_ns for scan in ours.scans] == [scan.stamp_ns for scan in theirs.scans]
        assert (ours.frame_id, ours.topic) == (theirs.frame_id, theirs.topic)


@cache
def ros2_types() -> Typestore:
    return get_typestore(Stores.ROS2_HUMBLE)


@cache
def ros1_types() -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", TRANSFORMS))
    return store


def header(store: Typestore, frame_id: str, stamp_ns: int) -> Any:
    extra = {"seq": 0} if "std_msgs/msg/Header" in store.types and _has_seq(store) else {}
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return store.types["std_msgs/msg/Header"](stamp=time, frame_id=frame_id, **extra)


def _has_seq(store: Typestore) -> bool:
    return any(name == "seq" for name, _ in store.fielddefs["std_msgs/msg/Header"][1])


def rings_of(scan: Scan, lasers: int = 16) -> np.ndarray:
    """One laser after the other, as drivers of most makes send them."""
    return np.arange(len(scan.points_m), dtype=np.uint16) % lasers


def cloud_message(store: Typestore, scan: Scan, frame_id: str) -> Any:
    """Fields out of order and with gaps, so that no reader gets away with assuming x y z; rings as of `rings_of`."""
    dtype = np.dtype(
        {
            "names": ["ring", "z", "y", "x", "intensity"],
            "formats": ["<u2", "<f4", "<f4", "<f4", "<f4"],
            "offsets": [0, 4, 8, 12, 20],
            "itemsize": 26,
        }
    )
    records = np.zeros(len(scan.points_m), dtype)
    records["x"], records["y"], records["z"] = scan.points_m.T
    records["intensity"] = scan.intensity
    records["ring"] = rings_of(scan)
    field = store.types["sensor_msgs/msg/PointField"]
    codes = {"ring": 4}
    return store.types[CLOUD](
        header=header(store, frame_id, scan.stamp_ns),
        height=1,
        width=len(records),
        fields=[
            field(name=name, offset=dtype.fields[name][1], datatype=codes.get(name, 7), count=1) for name in dtype.names
        ],
        is_bigendian=False,
        point_step=dtype.itemsize,
        row_step=dtype.itemsize * len(records),
        data=records.view(np.uint8).reshape(-1) if len(records) else np.empty(0, np.uint8),
        is_dense=True,
    )


def transform_message(store: Typestore, entries: list[tuple[str, str, list[float], list[float]]]) -> Any:
    """Entries are (parent, child, xyz, quaternion xyzw)."""
    types = store.types
    return types[TRANSFORMS](
        transforms=[
            types["geometry_msgs/msg/TransformStamped"](
                header=header(store, parent, START_NS),
                child_frame_id=child,
                transform=types["geometry_msgs/msg/Transform"](
                    translation=types["geometry_msgs/msg/Vector3"](*xyz),
                    rotation=types["geometry_msgs/msg/Quaternion"](*xyzw),
                ),
            )
            for parent, child, xyz, xyzw in entries
        ]
    )


def in_order(snapshot: Snapshot) -> Iterator[tuple[LidarScans, Scan]]:
    pairs = [(lidar, scan) for lidar in snapshot.lidars for scan in lidar.scans]
    yield from sorted(pairs, key=lambda pair: pair[1].stamp_ns)


def raw_messages(snapshot: Snapshot, store: Typestore, encoding: str) -> Iterator[tuple[str, str, int, bytes]]:
    """(topic, type, log time, bytes), static transforms first."""
    serialise = store.serialize_cdr if encoding == "cdr" else store.serialize_ros1
    if snapshot.static_transforms:
        entries = [
            (pose.target, pose.source, pose.xyz_m.tolist(), pose.quaternion_xyzw.tolist())
            for pose in snapshot.static_transforms
        ]
        yield "/tf_static", TRANSFORMS, START_NS, bytes(serialise(transform_message(store, entries), TRANSFORMS))
    for lidar, scan in in_order(snapshot):
        data = serialise(cloud_message(store, scan, lidar.frame_id), CLOUD)
        yield lidar.topic, CLOUD, scan.stamp_ns, bytes(data)


def write_mcap(
    snapshot: Snapshot,
    path: Path,
    *,
    encoding: str = "cdr",
    compression: CompressionType = CompressionType.ZSTD,
    indexed: bool = True,
    chunked: bool = True,
    chunk_size: int = 1024,
    checked: bool = True,
    messages: Iterable[tuple[str, str, int, bytes]] | None = None,
) -> None:
    """`messages` in place of the snapshot's own."""
    store = ros2_types() if encoding == "cdr" else ros1_types()
    with path.open("wb") as file:
        writer = McapWriter(
            file,
            chunk_size=chunk_size,
            compression=compression,
            use_chunking=chunked,
            index_types=IndexType.ALL if indexed else IndexType.NONE,
            enable_crcs=checked,
        )
        writer.start(profile="ros2" if encoding == "cdr" else "ros1", library="test")
        channels: dict[str, int] = {}
        for topic, message_type, log_time, data in messages or raw_messages(snapshot, store, encoding):
            if topic not in channels:
                name = message_type if encoding == "cdr" else message_type.replace("/msg/", "/")
                definition, _ = store.generate_msgdef(message_type, ros_version=2 if encoding == "cdr" else 1)
                schema = writer.register_schema(
                    name, "ros2msg" if encoding == "cdr" else "ros1msg", definition.encode()
                )
                channels[topic] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channels[topic], log_time, data, log_time)
        writer.finish()


def write_mcap_ros2(snapshot: Snapshot, path: Path) -> None:
    """By the `mcap_ros2` package's own serialiser."""
    store = ros2_types()
    definition, _ = store.generate_msgdef(CLOUD, ros_version=2)
    with path.open("wb") as file, McapRos2Writer(file, chunk_size=4096) as writer:
        schema = writer.register_msgdef(CLOUD, definition)
        for lidar, scan in in_order(snapshot):
            message = _plain(cloud_message(store, scan, lidar.frame_id))
            writer.write_message(lidar.topic, schema, message, log_time=scan.stamp_ns)


def _plain(message: Any) -> Any:
    if isinstance(message, list):
        return [_plain(entry) for entry in message]
    if isinstance(message, np.ndarray):
        return message.tobytes()
    if not hasattr(message, "__msgtype__"):
        return message
    return SimpleNamespace(**{name: _plain(value) for name, value in vars(message).items()})


def write_ros2_bag(
    snapshot: Snapshot,
    folder: Path,
    storage: rosbag2.StoragePlugin = rosbag2.StoragePlugin.SQLITE3,
    compression: rosbag2.CompressionMode = rosbag2.CompressionMode.NONE,
) -> None:
    store = ros2_types()
    writer = rosbag2.Writer(folder, version=9, storage_plugin=storage)
    if compression != rosbag2.CompressionMode.NONE:
        writer.set_compression(compression, rosbag2.CompressionFormat.ZSTD)
    with pytest.MonkeyPatch.context() as patch:
        # It need not outlast a loss of power, and waiting for the disk takes long.
        patch.setattr(Sqlite3Writer, "SQLITE_SCHEMA", f"PRAGMA synchronous = OFF;{Sqlite3Writer.SQLITE_SCHEMA}")
        with writer:
            _write_all(writer, raw_messages(snapshot, store, "cdr"), store)


def write_ros1_bag(snapshot: Snapshot, path: Path, compression: rosbag1.Writer.CompressionFormat | None = None) -> None:
    store = ros1_types()
    writer = rosbag1.Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    with writer:
        _write_all(writer, raw_messages(snapshot, store, "ros1"), store)


def _write_all(writer: Any, messages: Iterator[tuple[str, str, int, bytes]], store: Typestore) -> None:
    connections: dict[str, Any] = {}
    for topic, message_type, log_time, data in messages:
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, message_type, typestore=store)
        writer.write(connections[topic], log_time, data)
