# SPDX-License-Identifier: Apache-2.0
"""ROS 2 types with their serialisation."""

from collections.abc import Sequence
from dataclasses import asdict
from functools import cache
from typing import Any

from mcap.well_known import MessageEncoding, SchemaEncoding
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from multilica.geometry import Float32Array, RigidTransform
from multilica.pointcloud2 import PointCloud2, encode_points
from multilica.sinks.mcap.messages import MessageSchema
from multilica.snapshot import Scan

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
def _store() -> Typestore:
    return get_typestore(Stores.ROS2_HUMBLE)


def made(message_type: str, **fields: Any) -> Any:  # noqa: ANN401 - the classes are made by rosbags at run time
    """Make a message of a ROS 2 type."""
    return _store().types[message_type](**fields)


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
    definition, _ = _store().generate_msgdef(message_type, ros_version=2)
    return MessageSchema(message_type, SchemaEncoding.ROS2, definition.encode(), MessageEncoding.CDR)


@cache
def hash_of(message_type: str) -> str:
    """Return the hash of a type's description (REP 2016) as rosbag2 writes it."""
    return str(_store().hash_rihs01(message_type))


def serialised(message: Any) -> bytes:  # noqa: ANN401 - see made
    """Serialise to little-endian CDR."""
    return bytes(_store().serialize_cdr(message, message.__msgtype__))


def time_of(stamp_ns: int) -> Any:  # noqa: ANN401 - see made
    """Make a ``builtin_interfaces/msg/Time``.

    Raises:
        ValueError: before 1970 or after 2038.
    """
    if not 0 <= stamp_ns < ROS_END_NS:
        raise ValueError(f"found a stamp of {stamp_ns} ns; ROS has times from 1970 to 2038")
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return made("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def transforms(poses: Sequence[RigidTransform], stamp_ns: int) -> Any:  # noqa: ANN401 - see made
    """Make a ``tf2_msgs/msg/TFMessage``: each pose's source frame in its target frame."""
    return made(
        TRANSFORMS,
        transforms=[
            made(
                "geometry_msgs/msg/TransformStamped",
                header=header(pose.target, stamp_ns),
                child_frame_id=pose.source,
                transform=made(
                    "geometry_msgs/msg/Transform",
                    translation=xyz_of("geometry_msgs/msg/Vector3", pose.xyz_m.tolist()),
                    rotation=xyz_of("geometry_msgs/msg/Quaternion", pose.quaternion_xyzw.tolist()),
                ),
            )
            for pose in poses
        ],
    )


def scan_cloud(frame_id: str, stamp_ns: int, scan: Scan) -> Any:  # noqa: ANN401 - see made
    """Make a ``sensor_msgs/msg/PointCloud2`` with all that a scan has of its points."""
    packed = encode_points(scan.points_m, scan.intensity, rings=scan.rings, times_ns=scan.times_ns)
    return _cloud(frame_id, stamp_ns, packed)


def point_cloud(frame_id: str, stamp_ns: int, points_m: Float32Array) -> Any:  # noqa: ANN401 - see made
    """Make a ``sensor_msgs/msg/PointCloud2`` of points (N, 3) in that frame, as little-endian float32."""
    return _cloud(frame_id, stamp_ns, encode_points(points_m))


def _cloud(frame_id: str, stamp_ns: int, packed: PointCloud2) -> Any:  # noqa: ANN401 - see made
    return made(
        POINT_CLOUD,
        header=header(frame_id, stamp_ns),
        height=packed.height,
        width=packed.width,
        fields=[made("sensor_msgs/msg/PointField", **asdict(field)) for field in packed.fields],
        is_bigendian=packed.big_endian,
        point_step=packed.point_step,
        row_step=packed.row_step,
        data=packed.data,
        is_dense=True,
    )


def header(frame_id: str, stamp_ns: int) -> Any:  # noqa: ANN401 - see made
    """Make a ``std_msgs/msg/Header``."""
    return made("std_msgs/msg/Header", stamp=time_of(stamp_ns), frame_id=frame_id)


def xyz_of(message_type: str, xyz: Sequence[float]) -> Any:  # noqa: ANN401 - see made
    """Make a message of x, y, z and, if given, w."""
    return made(message_type, **dict(zip("xyzw", xyz, strict=False)))


def pose_of(xyz_m: Sequence[float], xyzw: Sequence[float] = (0.0, 0.0, 0.0, 1.0)) -> Any:  # noqa: ANN401 - see made
    """Make a ``geometry_msgs/msg/Pose``."""
    position, orientation = xyz_of("geometry_msgs/msg/Point", xyz_m), xyz_of("geometry_msgs/msg/Quaternion", xyzw)
    return made("geometry_msgs/msg/Pose", position=position, orientation=orientation)
