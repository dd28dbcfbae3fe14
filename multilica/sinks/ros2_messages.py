# SPDX-License-Identifier: Apache-2.0
"""A calibration in messages of ROS 2."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from multilica.geometry import RigidTransform
from multilica.pointcloud2 import LIDAR_NAME_KEY, encode_points
from multilica.sinks.drawing import Drawing
from multilica.sinks.mcap_messages import Message, MessageSchema
from multilica.sinks.narration import LogLine
from multilica.sinks.ros2_markers import marker_array
from multilica.sinks.ros2_qos import offered_qos
from multilica.snapshot import Float32Array

__all__ = ["Ros2Encoding"]

_TRANSFORMS = "tf2_msgs/msg/TFMessage"
_CLOUD = "sensor_msgs/msg/PointCloud2"
_LOG = "rcl_interfaces/msg/Log"
_STRING = "std_msgs/msg/String"
_LEVELS = {"DEBUG": 10, "INFO": 20, "WARN": 30, "ERROR": 40}


class Ros2Encoding:
    """CDR with message definitions, as rosbag2 writes it."""

    profile: str = Profile.ROS2

    def __init__(self) -> None:
        self._tokens: dict[str, str] = {}

    def transforms(self, poses: Sequence[RigidTransform], stamp_ns: int) -> Message:
        """``tf2_msgs/msg/TFMessage`` on `/tf_static`, latched for those who subscribe later."""
        message = _store().types[_TRANSFORMS](transforms=[_transform(pose, stamp_ns) for pose in poses])
        return _message("/tf_static", message, latched=True)

    def cloud(self, lidar: str, points_m: Float32Array, stamp_ns: int) -> Message:
        """``sensor_msgs/msg/PointCloud2`` of little-endian float32; the topic is named as ROS 2 allows."""
        types = _store().types
        packed = encode_points(points_m)
        fields = [
            types["sensor_msgs/msg/PointField"](
                name=field.name, offset=field.offset, datatype=field.datatype, count=field.count
            )
            for field in packed.fields
        ]
        message = types[_CLOUD](
            header=_header(lidar, stamp_ns),
            height=packed.height,
            width=packed.width,
            fields=fields,
            is_bigendian=packed.big_endian,
            point_step=packed.point_step,
            row_step=packed.row_step,
            data=packed.data,
            is_dense=True,
        )
        return _message(f"/lidar/{self._topic_token(lidar)}/points", message, {LIDAR_NAME_KEY: lidar})

    def drawings(self, topic: str, drawings: Sequence[Drawing], stamp_ns: int) -> Message:
        """``visualization_msgs/msg/MarkerArray``, a namespace per drawing, latched for those who subscribe later."""
        return _message(topic, marker_array(_store(), drawings, _time(stamp_ns)), latched=True)

    def log(self, line: LogLine, stamp_ns: int) -> Message:
        """``rcl_interfaces/msg/Log`` on `/log`."""
        message = _store().types[_LOG](
            stamp=_time(stamp_ns),
            level=_LEVELS[line.level],
            name="multilica",
            msg=line.text,
            file="",
            function="",
            line=0,
        )
        return _message("/log", message)

    def metrics(self, figures: Mapping[str, Any]) -> Message:
        """JSON in a ``std_msgs/msg/String`` on `/metrics`."""
        return _message("/metrics", _store().types[_STRING](data=json.dumps(figures, allow_nan=False)))

    def _topic_token(self, lidar: str) -> str:
        """The name with everything replaced that a ROS 2 topic may not hold, one token per LiDAR."""
        if lidar not in self._tokens:
            token = re.sub(r"[^A-Za-z0-9_]", "_", lidar)
            token = f"_{token}" if token[:1].isdigit() else token
            taken = set(self._tokens.values())
            candidates = (token, *(f"{token}_{number}" for number in range(2, len(taken) + 3)))
            self._tokens[lidar] = next(candidate for candidate in candidates if candidate not in taken)
        return self._tokens[lidar]


@cache
def _store() -> Typestore:
    return get_typestore(Stores.ROS2_HUMBLE)


@cache
def _schema(message_type: str) -> MessageSchema:
    definition, _ = _store().generate_msgdef(message_type, ros_version=2)
    return MessageSchema(message_type, SchemaEncoding.ROS2, definition.encode(), MessageEncoding.CDR)


def _message(
    topic: str,
    message: Any,  # noqa: ANN401 - the classes are made by rosbags at run time
    metadata: Mapping[str, str] | None = None,
    *,
    latched: bool = False,
) -> Message:
    message_type: str = message.__msgtype__
    data = bytes(_store().serialize_cdr(message, message_type))
    return Message(topic, _schema(message_type), data, {**offered_qos(latched=latched), **(metadata or {})})


def _time(stamp_ns: int) -> Any:  # noqa: ANN401 - see _message
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    return _store().types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)


def _header(frame_id: str, stamp_ns: int) -> Any:  # noqa: ANN401 - see _message
    return _store().types["std_msgs/msg/Header"](stamp=_time(stamp_ns), frame_id=frame_id)


def _transform(pose: RigidTransform, stamp_ns: int) -> Any:  # noqa: ANN401 - see _message
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
