# SPDX-License-Identifier: Apache-2.0
"""ROS 2 types with their serialisation."""

from collections.abc import Sequence
from functools import cache
from typing import Any

from mcap.well_known import MessageEncoding, SchemaEncoding
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from multilica.geometry import RigidTransform
from multilica.pointcloud2 import encode_points
from multilica.sinks.mcap.messages import MessageSchema
from multilica.snapshot import Float32Array

__all__ = [
    "POINT_CLOUD",
    "ROS_END_NS",
    "TRANSFORMS",
    "offered_qos",
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
"""End of ROS time, in 2038."""

_PROFILE = """\
- history: 1
  depth: {depth}
  reliability: 1
  durability: {durability}
  deadline: &forever
    sec: 9223372036
    nsec: 854775807
  lifespan: *forever
  liveliness: 1
  liveliness_lease_duration: *forever
  avoid_ros_namespace_conventions: false
"""
_TRANSIENT_LOCAL = 1
_VOLATILE = 2


@cache
def store() -> Typestore:
    """Return all types of a ROS 2 distribution; the classes are made at run time."""
    return get_typestore(Stores.ROS2_HUMBLE)


def offered_qos(*, latched: bool) -> dict[str, str]:
    """Return the channel metadata that rosbag2 reads.

    Args:
        latched: late subscribers get the last message, as with `/tf_static`.
    """
    depth, durability = (1, _TRANSIENT_LOCAL) if latched else (10, _VOLATILE)
    return {"offered_qos_profiles": _PROFILE.format(depth=depth, durability=durability)}


@cache
def schema_of(message_type: str) -> MessageSchema:
    """Return the schema of a type as rosbag2 writes it."""
    definition, _ = store().generate_msgdef(message_type, ros_version=2)
    return MessageSchema(message_type, SchemaEncoding.ROS2, definition.encode(), MessageEncoding.CDR)


def serialised(message: Any) -> bytes:  # noqa: ANN401 - see store
    """Serialise to little-endian CDR."""
    return bytes(store().serialize_cdr(message, message.__msgtype__))


def time_of(stamp_ns: int) -> Any:  # noqa: ANN401 - see store
    """Make a ``builtin_interfaces/msg/Time``.

    Raises:
        ValueError: before 1970 or after 2038.
    """
    if not 0 <= stamp_ns < ROS_END_NS:
        raise ValueError(f"found a stamp of {stamp_ns} ns; ROS has times from 1970 to 2038")
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return store().types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)


def transforms(poses: Sequence[RigidTransform], stamp_ns: int) -> Any:  # noqa: ANN401 - see store
    """Make a ``tf2_msgs/msg/TFMessage``: each pose's source frame in its target frame."""
    return store().types[TRANSFORMS](transforms=[_transform(pose, stamp_ns) for pose in poses])


def point_cloud(frame_id: str, stamp_ns: int, points_m: Float32Array, intensity: Float32Array | None = None) -> Any:  # noqa: ANN401 - see store
    """Make a ``sensor_msgs/msg/PointCloud2`` of little-endian float32: x, y, z and, if given, intensity.

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
