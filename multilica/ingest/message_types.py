# SPDX-License-Identifier: Apache-2.0
"""The registry of message types with points, and their decoding.

To add a message type, write its decoder in `messages/` and add one entry to `MESSAGE_TYPES`.
"""

import re
from dataclasses import dataclass, replace
from functools import cache
from importlib import import_module

from multilica.errors import UnreadableSourceError
from multilica.ingest.formats import FORMATS
from multilica.ingest.memory import require_decodable
from multilica.ingest.recording import RawMessage, Topic, reason_of
from multilica.optional_libraries import OPTIONAL_LIBRARIES
from multilica.snapshot import Scan

OUSTER_TURN = "ouster"
"""Encoding of a message that holds the sensor's metadata and all packets of one turn."""
OTHER_PACKETS = "ouster, no returns"
"""Encoding of packets without returns, such as those of the IMU."""
OUSTER = "ouster.sdk.core:LidarFrame"

_ROS = ("cdr", "ros1")


@dataclass(frozen=True, slots=True)
class MessageType:
    """A message type with points and its decoder.

    Args:
        names: ``package/msg/Name`` in ROS, the name of the schema elsewhere; drivers have several for one layout.
        encodings: those that the decoder reads.
        decoder: module in `multilica.ingest` with `decode_cloud(message) -> Cloud`, imported on first use; raises
            ValueError for a broken message, with a predicate as its text.
        requires: optional package of the decoder, as ``module`` or ``module:attribute``.
        packets: what raw packets hold and how to get points of them without a decoder; empty for point clouds.
        incomplete: the same where the decoder is installed, yet the recording lacks what it needs.
        unread: point clouds without a decoder, and how to get clouds of another type from them.
    """

    names: tuple[str, ...]
    encodings: tuple[str, ...] = ()
    decoder: str = ""
    requires: str = ""
    packets: str = ""
    incomplete: str = ""
    unread: str = ""


def _driver(packets: str, driver: str) -> str:
    return f"{packets}, which the driver {driver} turns into point clouds; replay the log through it"


def _decodable(packets: str, module: str, driver: str) -> str:
    command = OPTIONAL_LIBRARIES[module].install_command
    return f"{packets}; `{command}`, or replay the log through the driver {driver}"


COMPRESSED_CLOUDS = (
    "point_cloud_interfaces/msg/CompressedPointCloud2",
    "draco_point_cloud_transport/msg/CompressedPointCloud2",
)
"""Message types of the compressing transports of point_cloud_transport, of ROS 2 and ROS 1."""
_PACKETS = re.compile(r"Packet(s|Msg)?$")
_OTHER_MAKES = MessageType(
    (), packets="packets of an unknown make; if a LiDAR sent them, replay the log through its driver"
)
_CONVERTED = "turns into sensor_msgs/msg/PointCloud2; replay the log through it"

MESSAGE_TYPES = {
    name: entry
    for entry in (
        MessageType(("sensor_msgs/msg/PointCloud2",), _ROS, "messages.ros"),
        MessageType(("foxglove.PointCloud",), ("protobuf", "json"), "messages.foxglove"),
        MessageType(("livox_ros_driver/msg/CustomMsg",), ("ros1",), "messages.ros"),
        MessageType(("livox_ros_driver2/msg/CustomMsg",), _ROS, "messages.ros"),
        MessageType(("livox_interfaces/msg/CustomMsg",), ("cdr",), "messages.ros"),
        MessageType(
            ("velodyne_msgs/msg/VelodyneScan",),
            _ROS,
            "messages.velodyne_packets",
            requires="velodyne_decoder",
            packets=_decodable("packets of Velodyne", "velodyne_decoder", "velodyne_pointcloud"),
        ),
        MessageType(
            ("ouster_msgs/msg/PacketMsg", "ouster_ros/msg/PacketMsg", "ouster_sensor_msgs/msg/PacketMsg"),
            (OUSTER_TURN,),
            "messages.ouster_packets",
            requires=OUSTER,
            packets=_decodable("packets of Ouster", "ouster.sdk", "ouster_ros"),
            incomplete="packets of Ouster without the topic 'metadata' of its driver, which is needed to decode them; "
            "replay the log through the driver ouster_ros with the sensor's metadata file",
        ),
        MessageType(("hesai_lidar/msg/PandarScan",), packets=_driver("packets of Hesai", "HesaiLidar_General_ROS")),
        MessageType(("hesai_ros_driver/msg/UdpFrame",), packets=_driver("packets of Hesai", "HesaiLidar_ROS_2.0")),
        MessageType(
            ("nebula_msgs/msg/NebulaPackets",), packets=_driver("packets of Autoware's Nebula driver", "nebula_ros")
        ),
        MessageType(
            ("pandar_msgs/msg/PandarScan",),
            packets=_driver("packets of Hesai", "nebula_ros, or pandar_pointcloud of ROS 1,"),
        ),
        MessageType(("rslidar_msg/msg/RslidarPacket",), packets=_driver("packets of RoboSense", "rslidar_sdk")),
        MessageType(("rslidar_msgs/msg/rslidarScan",), packets=_driver("packets of RoboSense", "ros_rslidar")),
        MessageType(
            COMPRESSED_CLOUDS,
            unread=f"compressed clouds, which the node republish of point_cloud_transport {_CONVERTED}",
        ),
        MessageType(
            ("sensor_msgs/msg/PointCloud",),
            unread="clouds of the old type sensor_msgs/msg/PointCloud, which the node point_cloud_converter "
            f"{_CONVERTED}",
        ),
        MessageType(
            ("foxglove_msgs/msg/PointCloud",),
            unread="clouds of the ROS type foxglove_msgs/msg/PointCloud; record the sensor_msgs/msg/PointCloud2 that "
            "they are made of",
        ),
        *(
            MessageType((file.name.upper(),), (file.name,), file.reader)
            for file in FORMATS.values()
            if file.content == "cloud"
        ),
    )
    for name in entry.names
}
"""Name of the message type -> entry; point files count as messages, too."""


def is_packets(message_type: str) -> bool:
    """Return whether messages of this type are raw packets of a LiDAR of a known make."""
    known = MESSAGE_TYPES.get(message_type)
    return known is not None and bool(known.packets)


def _known(message_type: str) -> MessageType | None:
    is_other = _PACKETS.search(message_type) and "image_transport" not in message_type
    return MESSAGE_TYPES.get(message_type, _OTHER_MAKES if is_other else None)


@cache
def is_installed(requires: str) -> bool:
    """Return whether the optional package of a decoder can be imported in a version that has what is needed."""
    module, _, attribute = requires.partition(":")
    try:
        return not requires or hasattr(import_module(module), attribute or "__name__")
    except ImportError:
        return False


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """One decoded frame.

    Args:
        frame_id: without slashes at its ends; empty if the format has none.
        remark: what the user should know about the topic, as a predicate; empty for nothing.
        device: which LiDAR sent it, where the message says so and several may share a topic; empty elsewhere.
    """

    scan: Scan
    frame_id: str = ""
    remark: str = ""
    device: str = ""


def is_cloud(of: Topic | RawMessage) -> bool:
    """Return whether a message, or those on a topic, can be decoded to points."""
    known = MESSAGE_TYPES.get(of.message_type)
    return known is not None and of.encoding in known.encodings and is_installed(known.requires)


def obstacle(topic: Topic) -> str:
    """Return why a topic with points cannot be decoded and what to do about it; empty for every other topic."""
    known = _known(topic.message_type)
    if known is None or is_cloud(topic) or topic.encoding == OTHER_PACKETS:
        return ""
    if known.unread:
        return known.unread
    if known.packets:
        return known.incomplete if known.requires and is_installed(known.requires) else known.packets
    expected = " or ".join(known.encodings)
    return f"{topic.message_type} in the encoding {topic.encoding[:32]!r}; expected {expected}"


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode a message for which `is_cloud` is true; raise UnreadableSourceError if it is broken."""
    if message.fault:
        raise UnreadableSourceError(f"{message.origin} {message.fault}.")
    try:
        require_decodable(len(message.data))
        decoder = import_module(f"multilica.ingest.{MESSAGE_TYPES[message.message_type].decoder}")
        cloud: Cloud = decoder.decode_cloud(message)
    except ValueError as error:
        raise UnreadableSourceError(f"{message.origin} {error}.") from error
    except (ArithmeticError, AttributeError, LookupError, RecursionError, TypeError) as error:
        raise UnreadableSourceError(f"{message.origin} cannot be decoded: {reason_of(error)}.") from error
    if abs(cloud.scan.stamp_ns) >= 1 << 64:  # no time, and it would overflow
        return replace(cloud, scan=replace(cloud.scan, stamp_ns=message.log_time_ns))
    return cloud
