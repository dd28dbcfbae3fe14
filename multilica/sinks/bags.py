# SPDX-License-Identifier: Apache-2.0
"""Writers of point clouds as other recorders write their logs: ROS 1 bag, ROS 2 bag in SQLite, MCAP file of rosbag2.

They write the point clouds alone: names of LiDARs are frame ids, and there are no static transforms.
"""

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any, Final

from mcap.well_known import Profile
from mcap.writer import CompressionType
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from multilica.pointcloud2 import encode_points
from multilica.sinks.files.atomic import atomic_file
from multilica.sinks.mcap import ros2_types as ros2
from multilica.sinks.mcap.messages import McapMessage, mcap_messages
from multilica.snapshot import LidarScans, Scan, Snapshot

_POINT_CLOUD = ros2.POINT_CLOUD
_ROS2_BAG_VERSION: Final = 9
_METADATA_NAME = "log"


def write_ros1_bag(snapshot: Snapshot, path: Path) -> None:
    """Write a ROS 1 bag."""
    with _begun(path) as begun, rosbag1.Writer(begun) as writer:
        connections: dict[str, Connection] = {}
        for lidar, scan in _frames_in_order(snapshot):
            topic = _topic_of(lidar)
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, _POINT_CLOUD, typestore=_ros1_store())
            cloud = _ros1_store().serialize_ros1(_ros1_cloud(lidar.frame_id, scan), _POINT_CLOUD)
            writer.write(connections[topic], scan.stamp_ns, cloud)


def write_ros2_bag(snapshot: Snapshot, folder: Path, *, custom_data: Mapping[str, str] | None = None) -> None:
    """Write a ROS 2 bag in SQLite into a folder, which must not exist.

    Args:
        custom_data: entries of ``metadata.yaml``, for instance `vehicle`.
    """
    definition = ros2.schema_of(_POINT_CLOUD).data.decode()
    with _begun(folder) as begun:
        writer = rosbag2.Writer(begun, version=_ROS2_BAG_VERSION, storage_plugin=rosbag2.StoragePlugin.SQLITE3)
        for key, value in (custom_data or {}).items():
            writer.set_custom_data(key, value)
        connections: dict[str, Connection] = {}
        with writer:
            for lidar, scan in _frames_in_order(snapshot):
                topic = _topic_of(lidar)
                if topic not in connections:
                    connections[topic] = writer.add_connection(
                        topic, _POINT_CLOUD, msgdef=definition, rihs01=ros2.hash_of(_POINT_CLOUD)
                    )
                writer.write(connections[topic], scan.stamp_ns, _ros2_cloud(lidar.frame_id, scan))


def write_ros2_mcap(snapshot: Snapshot, path: Path, *, metadata: Mapping[str, str] | None = None) -> None:
    """Write an MCAP file of rosbag2, in CDR.

    Args:
        metadata: entries of the metadata record ``log``, for instance `vehicle`.
    """
    schema, channel = ros2.schema_of(_POINT_CLOUD), ros2.offered_qos(latched=False)
    with atomic_file(path) as file, mcap_messages(file, Profile.ROS2, compression=CompressionType.ZSTD) as messages:
        for lidar, scan in _frames_in_order(snapshot):
            cloud = _ros2_cloud(lidar.frame_id, scan)
            messages.write(McapMessage(_topic_of(lidar), schema, cloud, channel), scan.stamp_ns)
        if metadata:
            messages.writer.add_metadata(_METADATA_NAME, dict(metadata))


def _frames_in_order(snapshot: Snapshot) -> Iterator[tuple[LidarScans, Scan]]:
    """Yield each frame with its LiDAR, by stamp, then by name of the LiDAR."""
    frames = [(lidar, scan) for lidar in snapshot.lidars for scan in lidar.scans]
    yield from sorted(frames, key=lambda frame: frame[1].stamp_ns)


def _topic_of(lidar: LidarScans) -> str:
    """Return the topic of a LiDAR; a file has none."""
    return lidar.topic if lidar.topic.startswith("/") else f"/{lidar.name}/points"


@contextmanager
def _begun(path: Path) -> Iterator[Path]:
    """Yield a path of the same name in a hidden folder, where the block makes a file or folder, moved at its end."""
    folder = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    try:
        yield folder / path.name
        (folder / path.name).replace(path)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _ros2_cloud(frame_id: str, scan: Scan) -> bytes:
    return ros2.serialised(ros2.point_cloud(frame_id, scan.stamp_ns, scan.points_m, scan.intensity))


@cache
def _ros1_store() -> Typestore:
    return get_typestore(Stores.ROS1_NOETIC)


def _ros1_cloud(frame_id: str, scan: Scan) -> Any:  # noqa: ANN401 - the classes are made by rosbags at run time
    types, packed = _ros1_store().types, encode_points(scan.points_m, scan.intensity)
    seconds, nanoseconds = divmod(scan.stamp_ns, 10**9)
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    return types[_POINT_CLOUD](
        header=types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id=frame_id),
        height=packed.height,
        width=packed.width,
        fields=[types["sensor_msgs/msg/PointField"](**asdict(field)) for field in packed.fields],
        is_bigendian=packed.big_endian,
        point_step=packed.point_step,
        row_step=packed.row_step,
        data=packed.data,
        is_dense=True,
    )
