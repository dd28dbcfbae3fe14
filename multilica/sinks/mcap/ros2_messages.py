# SPDX-License-Identifier: Apache-2.0
"""ROS 2 messages of a calibration."""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from mcap.well_known import Profile

from multilica.geometry import Float32Array, RigidTransform
from multilica.pointcloud2 import LIDAR_NAME_KEY
from multilica.sinks.drawing import Drawing, Rgb
from multilica.sinks.mcap import ros2_types as ros2
from multilica.sinks.mcap.messages import McapMessage
from multilica.sinks.text.log_lines import LogLine

_LEVELS = {"DEBUG": 10, "INFO": 20, "WARN": 30, "ERROR": 40}
_SPHERE, _LINE_LIST, _TEXT = 2, 5, 9
_LINE_WIDTH_M = 0.03
_TEXT_HEIGHT_M = 0.15
_OPACITY = 0.6


class Ros2Encoding:
    """CDR messages with definitions, as rosbag2 writes them."""

    profile: str = Profile.ROS2

    def __init__(self) -> None:
        self._tokens: dict[str, str] = {}

    def transforms(self, poses: Sequence[RigidTransform], stamp_ns: int) -> McapMessage:
        """Encode ``tf2_msgs/msg/TFMessage`` on `/tf_static`, latched for late subscribers."""
        return _message("/tf_static", ros2.transforms(poses, stamp_ns), latched=True)

    def cloud(self, lidar: str, frame_id: str, points_m: Float32Array, stamp_ns: int) -> McapMessage:
        """Encode ``sensor_msgs/msg/PointCloud2`` of little-endian float32 on a valid ROS 2 topic."""
        topic = f"/lidar/{self._topic_token(lidar)}/points"
        return _message(topic, ros2.point_cloud(frame_id, stamp_ns, points_m), lidar=lidar)

    def drawings(self, topic: str, drawings: Sequence[Drawing], stamp_ns: int) -> McapMessage:
        """Encode ``visualization_msgs/msg/MarkerArray``, a namespace per drawing, latched for late subscribers."""
        markers = [
            _marker(drawing, stamp_ns, index, parts)
            for drawing in drawings
            for index, parts in enumerate(_parts(drawing))
        ]
        return _message(topic, ros2.made("visualization_msgs/msg/MarkerArray", markers=markers), latched=True)

    def stop_poses(self, first: str, poses: Sequence[RigidTransform], stamp_ns: int) -> McapMessage:
        """Encode ``geometry_msgs/msg/PoseArray``: poses in one frame, latched for late subscribers."""
        found = ros2.made(
            "geometry_msgs/msg/PoseArray",
            header=ros2.header(poses[0].target, stamp_ns),
            poses=[ros2.pose_of(pose.xyz_m.tolist(), pose.quaternion_xyzw.tolist()) for pose in poses],
        )
        return _message(f"/drive/{self._topic_token(first)}", found, latched=True)

    def log(self, line: LogLine, stamp_ns: int) -> McapMessage:
        """Encode ``rcl_interfaces/msg/Log`` on `/log`."""
        message = ros2.made(
            "rcl_interfaces/msg/Log",
            stamp=ros2.time_of(stamp_ns),
            level=_LEVELS[line.level],
            name="multilica",
            msg=line.text,
            file="",
            function="",
            line=0,
        )
        return _message("/log", message)

    def metrics(self, figures: Mapping[str, Any]) -> McapMessage:
        """Encode JSON in a ``std_msgs/msg/String`` on `/metrics`."""
        return _message("/metrics", ros2.made("std_msgs/msg/String", data=json.dumps(figures, allow_nan=False)))

    def _topic_token(self, name: str) -> str:
        """Return the name of a LiDAR or stop with invalid characters of ROS 2 topics replaced, unique per name."""
        if name not in self._tokens:
            token = re.sub(r"[^A-Za-z0-9_]", "_", name)
            token = f"_{token}" if token[:1].isdigit() else token
            taken = set(self._tokens.values())
            names = (token, *(f"{token}_{number}" for number in range(2, len(taken) + 3)))
            self._tokens[name] = next(each for each in names if each not in taken)
        return self._tokens[name]


def _message(topic: str, message: Any, *, latched: bool = False, lidar: str = "") -> McapMessage:  # noqa: ANN401 - the classes are made by rosbags at run time
    channel = ros2.offered_qos(latched=latched) | ({LIDAR_NAME_KEY: lidar} if lidar else {})
    return McapMessage(topic, ros2.schema_of(message.__msgtype__), ros2.serialised(message), channel)


def _parts(drawing: Drawing) -> Iterator[dict[str, Any]]:
    """Yield the fields that differ between the markers of a drawing."""
    for lines in drawing.lines:
        if len(lines.segments_m):
            points = [ros2.xyz_of("geometry_msgs/msg/Point", xyz) for xyz in lines.segments_m.reshape(-1, 3).tolist()]
            width = _size((_LINE_WIDTH_M, 0.0, 0.0))
            yield {"type": _LINE_LIST, "points": points, "scale": width, "color": _color(lines.colour)}
    for ellipsoid in drawing.ellipsoids:
        pose = ros2.pose_of(ellipsoid.pose.xyz_m.tolist(), ellipsoid.pose.quaternion_xyzw.tolist())
        size = _size((2.0 * ellipsoid.half_sizes_m).tolist())
        yield {"type": _SPHERE, "pose": pose, "scale": size, "color": _color(ellipsoid.colour, _OPACITY)}
    for label in drawing.labels:
        pose, height = ros2.pose_of(label.xyz_m.tolist()), _size((0.0, 0.0, _TEXT_HEIGHT_M))
        yield {"type": _TEXT, "pose": pose, "scale": height, "color": _color(label.colour), "text": label.text}


def _marker(drawing: Drawing, stamp_ns: int, index: int, parts: dict[str, Any]) -> Any:  # noqa: ANN401 - see _message
    """Make a marker that follows its frame, in the namespace of its drawing."""
    header = ros2.header(drawing.frame_id, stamp_ns)
    nothing = np.zeros(0, dtype=np.uint8)
    unused = {
        "action": 0,
        "pose": ros2.pose_of((0.0, 0.0, 0.0)),
        "lifetime": ros2.made("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        "frame_locked": True,
        "points": [],
        "colors": [],
        "texture_resource": "",
        "texture": ros2.made("sensor_msgs/msg/CompressedImage", header=header, format="", data=nothing),
        "uv_coordinates": [],
        "text": "",
        "mesh_resource": "",
        "mesh_file": ros2.made("visualization_msgs/msg/MeshFile", filename="", data=nothing),
        "mesh_use_embedded_materials": False,
    }
    return ros2.made("visualization_msgs/msg/Marker", header=header, ns=drawing.name, id=index, **{**unused, **parts})


def _size(xyz_m: Sequence[float]) -> Any:  # noqa: ANN401 - see _message
    return ros2.xyz_of("geometry_msgs/msg/Vector3", xyz_m)


def _color(colour: Rgb, opacity: float = 1.0) -> Any:  # noqa: ANN401 - see _message
    red, green, blue = (channel / 255.0 for channel in colour)
    return ros2.made("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=opacity)
