# SPDX-License-Identifier: Apache-2.0
"""A snapshot as a small indexed MCAP file that ROS tools open."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

import multilica
from multilica.geometry import RigidTransform
from multilica.pointcloud2 import LIDAR_NAME_KEY, encode_points
from multilica.sinks.atomic import atomic_file
from multilica.sinks.ros2_qos import offered_qos
from multilica.sinks.snapshot_metadata import METADATA_NAME, snapshot_metadata
from multilica.snapshot import Scan, Snapshot

__all__ = ["write_snapshot_mcap"]

_CLOUD = "sensor_msgs/msg/PointCloud2"
_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_CHUNK_BYTES = 4 << 20
_MAX_SECONDS = 2**31 - 1


def write_snapshot_mcap(snapshot: Snapshot, path: Path, *, metadata: Mapping[str, str] | None = None) -> None:
    """Write a snapshot so that `read_snapshot` gives the same points, stamps, names, frames and static transforms.

    ROS 2 profile, one ``sensor_msgs/PointCloud2`` of float32 per frame, zstd chunks with checksums, ``/tf_static``.
    The file takes its name when it is whole.

    Args:
        metadata: further entries of the metadata record, for instance those of `window_metadata`.
    """
    with atomic_file(path) as file:
        writer = Writer(file, chunk_size=_CHUNK_BYTES, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(profile=Profile.ROS2, library=f"multilica {multilica.__version__}")
        _write_static_transforms(writer, snapshot)
        _write_scans(writer, snapshot)
        writer.add_metadata(METADATA_NAME, snapshot_metadata(snapshot) | dict(metadata or {}))
        writer.finish()  # type: ignore[no-untyped-call]


def _write_static_transforms(writer: Writer, snapshot: Snapshot) -> None:
    if not snapshot.static_transforms:
        return
    stamp_ns = min((scan.stamp_ns for lidar in snapshot.lidars for scan in lidar.scans), default=0)
    types = _store().types
    message = types[_TRANSFORMS](transforms=[_stamped(pose, stamp_ns) for pose in snapshot.static_transforms])
    schema = _register_schema(writer, _TRANSFORMS)
    channel = writer.register_channel("/tf_static", MessageEncoding.CDR, schema, offered_qos(latched=True))
    writer.add_message(channel, stamp_ns, _serialised(message), stamp_ns)


def _write_scans(writer: Writer, snapshot: Snapshot) -> None:
    schema = _register_schema(writer, _CLOUD)
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
    frames = [(scan.stamp_ns, lidar, index) for lidar in snapshot.lidars for index, scan in enumerate(lidar.scans)]
    for stamp_ns, lidar, index in sorted(frames, key=lambda frame: frame[0]):
        data = _serialised(_cloud(lidar.scans[index], lidar.frame_id))
        writer.add_message(channels[lidar.name], stamp_ns, data, stamp_ns, index)


def _topics(snapshot: Snapshot) -> dict[str, str]:
    """The topic that a LiDAR came from, or one made of its name where it came from a file."""
    return {
        lidar.name: lidar.topic if lidar.topic.startswith("/") else f"/{lidar.name}/points" for lidar in snapshot.lidars
    }


@cache
def _store() -> Typestore:
    return get_typestore(Stores.ROS2_HUMBLE)


def _register_schema(writer: Writer, message_type: str) -> int:
    definition, _ = _store().generate_msgdef(message_type, ros_version=2)
    return int(writer.register_schema(message_type, SchemaEncoding.ROS2, definition.encode()))


def _serialised(message: Any) -> bytes:  # noqa: ANN401 - the classes are made by rosbags at run time
    return bytes(_store().serialize_cdr(message, message.__msgtype__))


def _header(frame_id: str, stamp_ns: int) -> Any:  # noqa: ANN401 - see _serialised
    types = _store().types
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    if not 0 <= seconds <= _MAX_SECONDS:
        raise ValueError(
            f"the stamp {stamp_ns} ns in frame '{frame_id}' lies outside 1970 to 2038, which is all that ROS can hold"
        )
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def _stamped(pose: RigidTransform, stamp_ns: int) -> Any:  # noqa: ANN401 - see _serialised
    types = _store().types
    x, y, z = pose.xyz_m.tolist()
    qx, qy, qz, qw = pose.quaternion_xyzw.tolist()
    return types["geometry_msgs/msg/TransformStamped"](
        header=_header(pose.target, stamp_ns),
        child_frame_id=pose.source,
        transform=types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z),
            rotation=types["geometry_msgs/msg/Quaternion"](x=qx, y=qy, z=qz, w=qw),
        ),
    )


def _cloud(scan: Scan, frame_id: str) -> Any:  # noqa: ANN401 - see _serialised
    types = _store().types
    cloud = encode_points(scan.points_m, scan.intensity)
    return types[_CLOUD](
        header=_header(frame_id, scan.stamp_ns),
        height=cloud.height,
        width=cloud.width,
        fields=[
            types["sensor_msgs/msg/PointField"](
                name=field.name, offset=field.offset, datatype=field.datatype, count=field.count
            )
            for field in cloud.fields
        ],
        is_bigendian=cloud.big_endian,
        point_step=cloud.point_step,
        row_step=cloud.row_step,
        data=cloud.data,
        is_dense=True,
    )
