# SPDX-License-Identifier: Apache-2.0
"""Writers of snapshots and of static transforms as MCAP files for ROS tools."""

import json
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path

from mcap.well_known import MessageEncoding, Profile
from mcap.writer import CompressionType, Writer

import multilica
from multilica.config import IngestConfig
from multilica.geometry import RigidTransform
from multilica.pointcloud2 import LIDAR_NAME_KEY, SNAPSHOT_METADATA_NAME
from multilica.sinks.files.atomic import atomic_file
from multilica.sinks.mcap import ros2_types as ros2
from multilica.sinks.mcap.messages import McapMessage, mcap_messages
from multilica.snapshot import LidarScans, Snapshot

_CHUNK_BYTES = 4 << 20
_LATEST_NS = 2**64 - 1
_STAMP_NS = 10**9
"""Readers treat zero as unset; the time of a static transform has no meaning."""


def write_snapshot_mcap(snapshot: Snapshot, path: Path, *, metadata: Mapping[str, str] | None = None) -> None:
    """Write a snapshot so that `read_snapshot` returns the same points, times, names, frames and static transforms.

    ROS 2 profile, one ``sensor_msgs/PointCloud2`` of float32 per frame, zstd chunks with checksums, ``/tf_static``;
    `metadata` adds entries to the metadata record, for instance of `window_metadata`.
    """
    zstd = {"chunk_size": _CHUNK_BYTES, "compression": CompressionType.ZSTD}
    with atomic_file(path) as file, mcap_messages(file, Profile.ROS2, **zstd) as messages:
        if snapshot.static_transforms:
            time_ns = min((time_ns for time_ns, _, _ in _frames(snapshot)), default=0)
            messages.write(_static_transforms(snapshot.static_transforms, _ros_stamp_ns(time_ns)), time_ns)
        _write_scans(messages.writer, snapshot)
        messages.writer.add_metadata(SNAPSHOT_METADATA_NAME, _origin(snapshot) | dict(metadata or {}))


def window_metadata(config: IngestConfig, vehicle: str = "") -> dict[str, str]:
    """Return the options with which a snapshot was taken."""
    window = {
        "frames": str(config.frames),
        "start_s": f"{config.start_s:g}",
        "start_at": config.start_at,
        "window": config.window,
        "window_s": f"{config.window_s:g}",
    }
    return window | ({"vehicle": vehicle} if vehicle else {})


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


def _write_scans(writer: Writer, snapshot: Snapshot) -> None:
    cloud_schema = ros2.schema_of(ros2.POINT_CLOUD)
    schema = int(writer.register_schema(cloud_schema.name, cloud_schema.encoding, cloud_schema.data))
    channels = {}
    for lidar in snapshot.lidars:
        topic = lidar.topic if lidar.topic.startswith("/") else f"/{lidar.name}/points"  # a file has no topic
        metadata = {LIDAR_NAME_KEY: lidar.name, **ros2.offered_qos(latched=False)}
        channels[lidar.name] = writer.register_channel(topic, MessageEncoding.CDR, schema, metadata)
    for time_ns, lidar, index in sorted(_frames(snapshot), key=lambda frame: frame[0]):
        scan = lidar.scans[index]
        cloud = ros2.point_cloud(lidar.frame_id, _ros_stamp_ns(scan.stamp_ns), scan.points_m, scan.intensity)
        writer.add_message(channels[lidar.name], time_ns, ros2.serialised(cloud), time_ns, index)


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
