# SPDX-License-Identifier: Apache-2.0
"""Writers of point clouds as other recorders write their logs: ROS 1 bag, ROS 2 bag in SQLite, MCAP file of rosbag2.

They write the point clouds alone: names of LiDARs are frame ids, and there are no static transforms.
"""

import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

from mcap.well_known import Profile
from mcap.writer import CompressionType
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from multilica.sinks.files.atomic import atomic_file
from multilica.sinks.mcap import ros2_types as ros2
from multilica.sinks.mcap.messages import McapMessage, mcap_messages
from multilica.snapshot import Scan, Snapshot

_ROS2_BAG_VERSION: Final = 9


def write_ros1_bag(snapshot: Snapshot, path: Path) -> None:
    """Write a ROS 1 bag."""
    store = get_typestore(Stores.ROS1_NOETIC)

    def encode(cloud: Any) -> Any:  # noqa: ANN401 - the classes are made by rosbags at run time
        stamp, frame_id = cloud.header.stamp, cloud.header.frame_id
        cloud.header = store.types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id=frame_id)
        return store.serialize_ros1(cloud, ros2.POINT_CLOUD)

    with _begun(path) as begun, rosbag1.Writer(begun) as writer:
        _write_frames(snapshot, writer, encode, typestore=store)


def write_ros2_bag(snapshot: Snapshot, folder: Path, *, custom_data: Mapping[str, str] | None = None) -> None:
    """Write a ROS 2 bag in SQLite into a folder, which must not exist.

    Args:
        custom_data: entries of ``metadata.yaml``, for instance `vehicle`.
    """
    definition, rihs01 = ros2.schema_of(ros2.POINT_CLOUD).data.decode(), ros2.hash_of(ros2.POINT_CLOUD)
    with _begun(folder) as begun:
        writer = rosbag2.Writer(begun, version=_ROS2_BAG_VERSION, storage_plugin=rosbag2.StoragePlugin.SQLITE3)
        for key, value in (custom_data or {}).items():
            writer.set_custom_data(key, value)
        with writer:
            _write_frames(snapshot, writer, ros2.serialised, msgdef=definition, rihs01=rihs01)


def write_ros2_mcap(snapshot: Snapshot, path: Path, *, metadata: Mapping[str, str] | None = None) -> None:
    """Write an MCAP file of rosbag2, in CDR.

    Args:
        metadata: entries of the metadata record ``log``, for instance `vehicle`.
    """
    schema, channel = ros2.schema_of(ros2.POINT_CLOUD), ros2.offered_qos(latched=False)
    with atomic_file(path) as file, mcap_messages(file, Profile.ROS2, compression=CompressionType.ZSTD) as messages:
        for topic, scan, cloud in _clouds_in_order(snapshot):
            messages.write(McapMessage(topic, schema, ros2.serialised(cloud), channel), scan.stamp_ns)
        if metadata:
            messages.writer.add_metadata("log", dict(metadata))


def _write_frames(snapshot: Snapshot, writer: Any, encode: Callable[[Any], Any], **kind: Any) -> None:  # noqa: ANN401
    connections: dict[str, Connection] = {}
    for topic, scan, cloud in _clouds_in_order(snapshot):
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, ros2.POINT_CLOUD, **kind)
        writer.write(connections[topic], scan.stamp_ns, encode(cloud))


def _clouds_in_order(snapshot: Snapshot) -> Iterator[tuple[str, Scan, Any]]:
    """Yield topic, scan and ROS 2 message of each frame, by stamp, then by name of the LiDAR."""
    frames = [(lidar, scan) for lidar in snapshot.lidars for scan in lidar.scans]
    for lidar, scan in sorted(frames, key=lambda frame: frame[1].stamp_ns):
        # A point file has no topic.
        topic = lidar.topic if lidar.topic.startswith("/") else f"/{lidar.name}/points"
        yield topic, scan, ros2.point_cloud(lidar.frame_id, scan.stamp_ns, scan.points_m, scan.intensity)


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
