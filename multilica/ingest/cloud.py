# SPDX-License-Identifier: Apache-2.0
"""Messages that are point clouds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import cast

from multilica.errors import UnreadableSourceError
from multilica.ingest.packets import OUSTER_TURN, OUSTER_TYPES, PACKET_TYPES, missing_decoder
from multilica.ingest.recording import Message, Topic
from multilica.snapshot import Scan

__all__ = ["Cloud", "decode_cloud", "is_cloud", "obstacle"]

_DECODERS = {
    ("sensor_msgs/msg/PointCloud2", "cdr"): "ros_messages",
    ("sensor_msgs/msg/PointCloud2", "ros1"): "ros_messages",
    ("foxglove.PointCloud", "protobuf"): "foxglove_messages",
    ("foxglove.PointCloud", "json"): "foxglove_messages",
    ("livox_ros_driver/msg/CustomMsg", "ros1"): "livox_messages",
    ("livox_ros_driver2/msg/CustomMsg", "ros1"): "livox_messages",
    ("livox_ros_driver2/msg/CustomMsg", "cdr"): "livox_messages",
    ("livox_interfaces/msg/CustomMsg", "cdr"): "livox_messages",
    ("velodyne_msgs/msg/VelodyneScan", "cdr"): "velodyne_packets",
    ("velodyne_msgs/msg/VelodyneScan", "ros1"): "velodyne_packets",
    **{(message_type, OUSTER_TURN): "ouster_packets" for message_type in OUSTER_TYPES},
    ("PCD", "pcd"): "pcd",
    ("PLY", "ply"): "ply",
    ("LAS", "las"): "las",
    ("NPY", "npy"): "raw_arrays",
    ("KITTI", "kitti"): "raw_arrays",
    ("NUSCENES", "nuscenes"): "raw_arrays",
}
"""(message type, encoding) -> module beside this one whose `decode_cloud` unpacks it."""
_SHOWN = 32


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """One unpacked frame.

    Args:
        frame_id: as the message says, without slashes at its ends; empty where the format has none.
        remark: what the user should know about its topic, as a predicate; empty: nothing.
    """

    scan: Scan
    frame_id: str = ""
    remark: str = ""


def is_cloud(of: Topic | Message) -> bool:
    """Whether this message, or those on this topic, can be unpacked to points."""
    return (of.message_type, of.encoding) in _DECODERS and not missing_decoder(of.message_type, of.encoding)


def obstacle(topic: Topic) -> str:
    """What a topic of points holds that cannot be read here, and what to do about it; empty for every other topic."""
    encodings = [encoding for message_type, encoding in _DECODERS if message_type == topic.message_type]
    if encodings and topic.encoding not in encodings and topic.message_type not in PACKET_TYPES:
        expected = " or ".join(encodings)
        return f"{topic.message_type} in the encoding {topic.encoding[:_SHOWN]!r}; expected {expected}"
    return missing_decoder(topic.message_type, topic.encoding)


def decode_cloud(message: Message) -> Cloud:
    """Unpack a message of a topic for which `is_cloud` holds.

    Raises:
        UnreadableSourceError: the message is broken.
    """
    if message.fault:
        raise UnreadableSourceError(f"{message.origin} {message.fault}.")
    try:
        return _decoder(message.message_type, message.encoding)(message)
    except ValueError as error:
        raise UnreadableSourceError(f"{message.origin} {error}.") from error


@cache
def _decoder(message_type: str, encoding: str) -> Callable[[Message], Cloud]:
    module = import_module(f"multilica.ingest.{_DECODERS[message_type, encoding]}")
    return cast(Callable[[Message], Cloud], module.decode_cloud)
