# SPDX-License-Identifier: Apache-2.0
"""What ROS 2's own deserialisation sees in a file, as JSON: ``read_ros2.py FILE``, by a Python that has rclpy."""

import importlib
import json
import sys
from pathlib import Path

from mcap.reader import make_reader
from rclpy.serialization import deserialize_message, serialize_message

WITHOUT_PACKAGE = {"tf2_msgs/msg/TFMessage"}  # no package available


def kind_of(name):
    package, _, message = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), message)


def summary(message):
    """Return values that show that a message was decoded."""
    kind = type(message).__name__
    if kind == "PointCloud2":
        return [message.header.frame_id, message.width, message.point_step, len(message.data)]
    if kind == "PoseArray":
        return [message.header.frame_id, len(message.poses)]
    if kind == "MarkerArray":
        return sorted({marker.ns for marker in message.markers})
    return message.msg if kind == "Log" else message.data


def read(path):
    found = {}
    with Path(path).open("rb") as file:
        for schema, channel, raw in make_reader(file, validate_crcs=True).iter_messages():
            if schema.name in WITHOUT_PACKAGE:
                continue
            message = deserialize_message(raw.data, kind_of(schema.name))
            again = deserialize_message(serialize_message(message), type(message))
            assert again == message, channel.topic
            found.setdefault(channel.topic, []).append(summary(message))
    return found


print(json.dumps(read(sys.argv[1])))
