# SPDX-License-Identifier: Apache-2.0
"""Writer of snapshots as MCAP files for ROS tools."""

from collections.abc import Mapping
from pathlib import Path

from mcap.well_known import MessageEncoding, Profile
from mcap.writer import CompressionType, Writer

import multilica
from multilica.pointcloud2 import LIDAR_NAME_KEY, SNAPSHOT_METADATA_NAME
from multilica.sinks.files.atomic import atomic_file
from multilica.sinks.mcap.ros2_types import (
    POINT_CLOUD,
    ROS_END_NS,
    TRANSFORMS,
    offered_qos,
    point_cloud,
    schema_of,
    serialised,
    transforms,
)
from multilica.sinks.mcap.snapshot_metadata import snapshot_metadata
from multilica.snapshot import LidarScans, Snapshot

__all__ = ["write_snapshot_mcap"]

_CHUNK_BYTES = 4 << 20
_LATEST_NS = 2**64 - 1


def write_snapshot_mcap(snapshot: Snapshot, path: Path, *, metadata: Mapping[str, str] | None = None) -> None:
    """Write a snapshot so that `read_snapshot` returns the same points, times, names, frames and static transforms.

    ROS 2 profile, one ``sensor_msgs/PointCloud2`` of float32 per frame, zstd chunks with checksums, ``/tf_static``.

    Args:
        metadata: further entries of the metadata record, for instance of `window_metadata`.
    """
    with atomic_file(path) as file:
        writer = Writer(file, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(profile=Profile.ROS2, library=f"multilica {multilica.__version__}")
        _write_static_transforms(writer, snapshot)
        _write_scans(writer, snapshot)
        writer.add_metadata(SNAPSHOT_METADATA_NAME, snapshot_metadata(snapshot) | dict(metadata or {}))
        writer.finish()  # type: ignore[no-untyped-call]


def _write_static_transforms(writer: Writer, snapshot: Snapshot) -> None:
    if not snapshot.static_transforms:
        return
    time_ns = min((time_ns for time_ns, _, _ in _frames(snapshot)), default=0)
    data = serialised(transforms(snapshot.static_transforms, _ros_stamp_ns(time_ns)))
    schema = _register_schema(writer, TRANSFORMS)
    channel = writer.register_channel("/tf_static", MessageEncoding.CDR, schema, offered_qos(latched=True))
    writer.add_message(channel, time_ns, data, time_ns)


def _write_scans(writer: Writer, snapshot: Snapshot) -> None:
    schema = _register_schema(writer, POINT_CLOUD)
    topics = _topics(snapshot)
    channels = {
        lidar.name: writer.register_channel(
            topics[lidar.name],
            MessageEncoding.CDR,
            schema,
            {LIDAR_NAME_KEY: lidar.name, **offered_qos(latched=False)},
        )
        for lidar in snapshot.lidars
    }
    for time_ns, lidar, index in sorted(_frames(snapshot), key=lambda frame: frame[0]):
        scan = lidar.scans[index]
        data = serialised(point_cloud(lidar.frame_id, _ros_stamp_ns(scan.stamp_ns), scan.points_m, scan.intensity))
        writer.add_message(channels[lidar.name], time_ns, data, time_ns, index)


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
    return stamp_ns if 0 <= stamp_ns < ROS_END_NS else 0


def _topics(snapshot: Snapshot) -> dict[str, str]:
    """Return the topic of each LiDAR, or one made of its name if it came from a file."""
    return {
        lidar.name: lidar.topic if lidar.topic.startswith("/") else f"/{lidar.name}/points" for lidar in snapshot.lidars
    }


def _register_schema(writer: Writer, message_type: str) -> int:
    schema = schema_of(message_type)
    return int(writer.register_schema(schema.name, schema.encoding, schema.data))
