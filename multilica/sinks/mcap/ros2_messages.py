# SPDX-License-Identifier: Apache-2.0
"""ROS 2 messages of a calibration."""

import json
import re
from collections.abc import Mapping, Sequence
from typing import Any

from mcap.well_known import Profile

from multilica.geometry import RigidTransform
from multilica.pointcloud2 import LIDAR_NAME_KEY
from multilica.sinks.drawing.primitives import Drawing
from multilica.sinks.mcap.messages import McapMessage
from multilica.sinks.mcap.ros2_markers import marker_array
from multilica.sinks.mcap.ros2_types import offered_qos, point_cloud, schema_of, serialised, store, time_of, transforms
from multilica.sinks.text.log_lines import LogLine
from multilica.snapshot import Float32Array

__all__ = ["Ros2Encoding"]

_LOG = "rcl_interfaces/msg/Log"
_STRING = "std_msgs/msg/String"
_LEVELS = {"DEBUG": 10, "INFO": 20, "WARN": 30, "ERROR": 40}


class Ros2Encoding:
    """CDR messages with definitions, as rosbag2 writes them."""

    profile: str = Profile.ROS2

    def __init__(self) -> None:
        self._tokens: dict[str, str] = {}

    def transforms(self, poses: Sequence[RigidTransform], stamp_ns: int) -> McapMessage:
        """Encode ``tf2_msgs/msg/TFMessage`` on `/tf_static`, latched for late subscribers."""
        return _message("/tf_static", transforms(poses, stamp_ns), latched=True)

    def cloud(self, lidar: str, points_m: Float32Array, stamp_ns: int) -> McapMessage:
        """Encode ``sensor_msgs/msg/PointCloud2`` of little-endian float32 on a valid ROS 2 topic."""
        return _message(
            f"/lidar/{self._topic_token(lidar)}/points", point_cloud(lidar, stamp_ns, points_m), {LIDAR_NAME_KEY: lidar}
        )

    def drawings(self, topic: str, drawings: Sequence[Drawing], stamp_ns: int) -> McapMessage:
        """Encode ``visualization_msgs/msg/MarkerArray``, a namespace per drawing, latched for late subscribers."""
        return _message(topic, marker_array(store(), drawings, time_of(stamp_ns)), latched=True)

    def log(self, line: LogLine, stamp_ns: int) -> McapMessage:
        """Encode ``rcl_interfaces/msg/Log`` on `/log`."""
        message = store().types[_LOG](
            stamp=time_of(stamp_ns),
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
        return _message("/metrics", store().types[_STRING](data=json.dumps(figures, allow_nan=False)))

    def _topic_token(self, lidar: str) -> str:
        """Return the name with invalid characters of ROS 2 topics replaced, unique per LiDAR."""
        if lidar not in self._tokens:
            token = re.sub(r"[^A-Za-z0-9_]", "_", lidar)
            token = f"_{token}" if token[:1].isdigit() else token
            taken = set(self._tokens.values())
            names = (token, *(f"{token}_{number}" for number in range(2, len(taken) + 3)))
            self._tokens[lidar] = next(name for name in names if name not in taken)
        return self._tokens[lidar]


def _message(
    topic: str,
    message: Any,  # noqa: ANN401 - the classes are made by rosbags at run time
    metadata: Mapping[str, str] | None = None,
    *,
    latched: bool = False,
) -> McapMessage:
    message_type: str = message.__msgtype__
    return McapMessage(
        topic, schema_of(message_type), serialised(message), {**offered_qos(latched=latched), **(metadata or {})}
    )
