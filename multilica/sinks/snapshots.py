# SPDX-License-Identifier: Apache-2.0
"""Writers of snapshots and of static transforms as files of ROS tools: MCAP, and bags as other recorders write them."""

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Final

from mcap.well_known import MessageEncoding, Profile
from mcap.writer import CompressionType
from rosbags import rosbag1, rosbag2
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

import multilica
from multilica.config import IngestConfig
from multilica.geometry import RigidTransform
from multilica.pointcloud2 import LIDAR_NAME_KEY, SNAPSHOT_METADATA_NAME
from multilica.sinks.files.atomic import atomic_file
from multilica.sinks.mcap import ros2_types as ros2
from multilica.sinks.mcap.messages import McapMessage, mcap_messages
from multilica.snapshot import LidarScans, Scan, Snapshot

_CHUNK_BYTES = 4 << 20
_LATEST_NS = 2**64 - 1
_STAMP_NS = 10**9
"""Readers treat zero as unset; the time of a static transform has no meaning."""
_ROS2_BAG_VERSION: Final = 9


def write_snapshot_mcap(snapshot: Snapshot, path: Path, *, metadata: Mapping[str, str] | None = None) -> None:
    """Write a snapshot so that `read_snapshot` returns the same points, times, names, frames and static transforms.

    ROS 2 profile, one ``sensor_msgs/PointCloud2`` per frame, zstd chunks with checksums, ``/tf_static``;
    `metadata` adds entries to the metadata record, for instance of `window_metadata`.
    """
    zstd = {"chunk_size": _CHUNK_BYTES, "compression": CompressionType.ZSTD}
    with atomic_file(path) as file, mcap_messages(file, Profile.ROS2, **zstd) as messages:
        if snapshot.static_transforms:
            time_ns = min((time_ns for time_ns, _, _ in _frames(snapshot)), default=0)
            messages.write(_static_transforms(snapshot.static_transforms, _ros_stamp_ns(time_ns)), time_ns)
        cloud_schema, writer = ros2.schema_of(ros2.POINT_CLOUD), messages.writer
        schema = int(writer.register_schema(cloud_schema.name, cloud_schema.encoding, cloud_schema.data))
        channels = {}
        for lidar in snapshot.lidars:
            given = {LIDAR_NAME_KEY: lidar.name, **ros2.offered_qos(latched=False)}
            channels[lidar.name] = writer.register_channel(_topic(lidar), MessageEncoding.CDR, schema, given)
        for time_ns, lidar, index in sorted(_frames(snapshot), key=lambda frame: frame[0]):
            scan = lidar.scans[index]
            cloud = ros2.scan_cloud(lidar.frame_id, _ros_stamp_ns(scan.stamp_ns), scan)
            writer.add_message(channels[lidar.name], time_ns, ros2.serialised(cloud), time_ns, index)
        writer.add_metadata(SNAPSHOT_METADATA_NAME, _origin(snapshot) | dict(metadata or {}))


def window_metadata(config: IngestConfig, vehicle: str = "", stops: Sequence[tuple[int, int]] = ()) -> dict[str, str]:
    """Return the options with which a snapshot was taken, and the log times of the stops that it has."""
    window = {
        "frames": str(config.frames),
        "start_s": f"{config.start_s:g}",
        "start_at": config.start_at,
        "window": config.window,
        "window_s": f"{config.window_s:g}",
    }
    of_stops = {"stops": json.dumps(stops)} if len(stops) > 1 else {}
    return window | of_stops | ({"vehicle": vehicle} if vehicle else {})


def _origin(snapshot: Snapshot) -> dict[str, str]:
    stamps = [scan.stamp_ns for lidar in snapshot.lidars for scan in lidar.scans] or [0]
    return {
        "lidars": ", ".join(snapshot.names),
        "source": snapshot.source,
        "source_sha256": snapshot.source_sha256,
        "first_stamp_ns": str(min(stamps)),
        "last_stamp_ns": str(max(stamps)),
        "notes": json.dumps(snapshot.notes),
        "version": multilica.__version__,
    }


def _static_transforms(poses: Sequence[RigidTransform], stamp_ns: int) -> McapMessage:
    data = ros2.serialised(ros2.transforms(poses, stamp_ns))
    return McapMessage("/tf_static", ros2.schema_of(ros2.TRANSFORMS), data, ros2.offered_qos(latched=True))


def _topic(lidar: LidarScans) -> str:
    """Return the topic of a LiDAR, also of one that was read from a point file and has none."""
    return lidar.topic if lidar.topic.startswith("/") else f"/{lidar.name}/points"


def _frames(snapshot: Snapshot) -> list[tuple[int, LidarScans, int]]:
    """Return log time (stamp if there are no log times), LiDAR and index of each frame."""
    frames = [(scan, lidar, index) for lidar in snapshot.lidars for index, scan in enumerate(lidar.scans)]
    has_log_times = any(scan.log_time_ns for scan, _, _ in frames)
    return [
        (min(max(0, scan.log_time_ns if has_log_times else scan.stamp_ns), _LATEST_NS), lidar, index)
        for scan, lidar, index in frames
    ]


def _ros_stamp_ns(stamp_ns: int) -> int:
    """Return the stamp, or zero if it is outside ROS time; readers then use the log time."""
    return stamp_ns if 0 <= stamp_ns < ros2.ROS_END_NS else 0


def static_transforms_mcap(poses: Sequence[RigidTransform]) -> bytes:
    """Return a ROS 2 recording with one ``tf2_msgs/msg/TFMessage`` on `/tf_static`, latched for late subscribers."""
    file = BytesIO()
    with mcap_messages(file, Profile.ROS2) as messages:
        messages.write(_static_transforms(poses, _STAMP_NS), _STAMP_NS)
    return file.getvalue()


def write_ros1_bag(snapshot: Snapshot, path: Path) -> None:
    """Write the point clouds alone into a ROS 1 bag, in frames with the names of the LiDARs."""
    store = get_typestore(Stores.ROS1_NOETIC)

    def encode(cloud: Any) -> Any:  # noqa: ANN401 - the classes are made by rosbags at run time
        stamp, frame_id = cloud.header.stamp, cloud.header.frame_id
        cloud.header = store.types["std_msgs/msg/Header"](seq=0, stamp=stamp, frame_id=frame_id)
        return store.serialize_ros1(cloud, ros2.POINT_CLOUD)

    with _begun(path) as begun, rosbag1.Writer(begun) as writer:
        _write_frames(snapshot, writer, encode, typestore=store)


def write_ros2_bag(snapshot: Snapshot, folder: Path, *, custom_data: Mapping[str, str] | None = None) -> None:
    """Write the same as `write_ros1_bag` into a ROS 2 bag in SQLite: a folder, which must not exist.

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
    """Write the same as `write_ros1_bag`, and ``/tf_static``, into an MCAP file of rosbag2, in CDR.

    Args:
        metadata: entries of the metadata record ``log``, for instance `vehicle`.
    """
    schema, channel = ros2.schema_of(ros2.POINT_CLOUD), ros2.offered_qos(latched=False)
    with atomic_file(path) as file, mcap_messages(file, Profile.ROS2, compression=CompressionType.ZSTD) as messages:
        if snapshot.static_transforms:
            start_ns = min((scan.stamp_ns for lidar in snapshot.lidars for scan in lidar.scans), default=0)
            messages.write(_static_transforms(snapshot.static_transforms, _ros_stamp_ns(start_ns)), start_ns)
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
        yield _topic(lidar), scan, ros2.scan_cloud(lidar.frame_id, scan.stamp_ns, scan)


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
