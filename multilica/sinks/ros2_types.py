# SPDX-License-Identifier: Apache-2.0
"""Messages of ROS 2 and their bytes."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

from mcap.well_known import MessageEncoding, SchemaEncoding
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from multilica.geometry import RigidTransform
from multilica.pointcloud2 import encode_points
from multilica.sinks.mcap_messages import MessageSchema
from multilica.snapshot import Float32Array

__all__ = [
    "POINT_CLOUD",
    "ROS_END_NS",
    "TRANSFORMS",
    "point_cloud",
    "schema_of",
    "serialised",
    "store",
    "time_of",
    "transforms",
]

POINT_CLOUD = "sensor_msgs/msg/PointCloud2"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
ROS_END_NS = 2**31 * 10**9
"""In 2038: ROS has no stamps from then on."""


@cache
def store() -> Typestore:
    """All types of a distribution of ROS 2; the classes are made at run time."""
    return get_typestore(Stores.ROS2_HUMBLE)


@cache
def schema_of(message_type: str) -> MessageSchema:
    """How rosbag2 describes that type."""
    definition, _ = store().generate_msgdef(message_type, ros_version=2)
    return MessageSchema(message_type, SchemaEncoding.ROS2, definition.encode(), MessageEncoding.CDR)


def serialised(message: Any) -> bytes:  # noqa: ANN401 - see store
    """CDR, little-endian."""
    return bytes(store().serialize_cdr(message, message.__msgtype__))


def time_of(stamp_ns: int) -> Any:  # noqa: ANN401 - see store
    """``builtin_interfaces/msg/Time``.

    Raises:
        ValueError: before 1970 or after 2038, which it cannot hold.
    """
    if not 0 <= stamp_ns < ROS_END_NS:
        raise ValueError(f"the stamp {stamp_ns} ns lies outside 1970 to 2038, which is all that ROS can hold")
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return store().types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)


def transforms(poses: Sequence[RigidTransform], stamp_ns: int) -> Any:  # noqa: ANN401 - see store
    """``tf2_msgs/msg/TFMessage``: each pose's source frame in its target frame."""
    return store().types[TRANSFORMS](transforms=[_transform(pose, stamp_ns) for pose in poses])


def point_cloud(frame_id: str, stamp_ns: int, points_m: Float32Array, intensity: Float32Array | None = None) -> Any:  # noqa: ANN401 - see store
    """``sensor_msgs/msg/PointCloud2`` of little-endian float32: x, y, z and, where there is one, intensity.

    Args:
        points_m: (N, 3) in that frame.
        intensity: (N,).
    """
    types = store().types
    packed = encode_points(points_m, intensity)
    return types[POINT_CLOUD](
        header=_header(frame_id, stamp_ns),
        height=packed.height,
        width=packed.width,
        fields=[
            types["sensor_msgs/msg/PointField"](
                name=field.name, offset=field.offset, datatype=field.datatype, count=field.count
            )
            for field in packed.fields
        ],
        is_bigendian=packed.big_endian,
        point_step=packed.point_step,
        row_step=packed.row_step,
        data=packed.data,
        is_dense=True,
    )


def _header(frame_id: str, stamp_ns: int) -> Any:  # noqa: ANN401 - see store
    return store().types["std_msgs/msg/Header"](stamp=time_of(stamp_ns), frame_id=frame_id)


def _transform(pose: RigidTransform, stamp_ns: int) -> Any:  # noqa: ANN401 - see store
    types = store().types
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
