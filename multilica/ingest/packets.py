# SPDX-License-Identifier: Apache-2.0
"""Raw packets of LiDARs: which can be read here, and what to run for the others."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec

__all__ = ["OTHER_PACKETS", "OUSTER_TURN", "OUSTER_TYPES", "PACKET_TYPES", "has_ouster_decoder", "missing_decoder"]

OUSTER_TURN = "ouster"
"""Encoding of messages that hold all packets of a turn with the sensor's metadata."""
OTHER_PACKETS = "ouster, no returns"
"""Encoding of packets that hold none of a LiDAR's returns."""

_OUSTER = (
    "packets of Ouster; `pip install --no-deps 'ouster-sdk>=1.0'`, or replay the log through the driver ouster_ros"
)
_OUSTER_ALONE = (
    "packets of Ouster, yet beside them is no topic 'metadata' of its driver, which tells how they are to be read; "
    "replay the log through the driver ouster_ros with the sensor's metadata file"
)
_VELODYNE = (
    "packets of Velodyne; `pip install 'multilica[velodyne]'`, or replay the log through the driver velodyne_pointcloud"
)


def _replayed(packets: str, driver: str) -> str:
    """What to do about packets that nothing but a driver for ROS unpacks; each driver has a message type of its own."""
    return f"{packets}, which the driver {driver} turns into point clouds; replay the log through it"


OUSTER_TYPES = ("ouster_msgs/msg/PacketMsg", "ouster_ros/msg/PacketMsg", "ouster_sensor_msgs/msg/PacketMsg")
PACKET_TYPES = {
    "velodyne_msgs/msg/VelodyneScan": _VELODYNE,
    **dict.fromkeys(OUSTER_TYPES, _OUSTER),
    "hesai_lidar/msg/PandarScan": _replayed("packets of Hesai", "HesaiLidar_General_ROS"),
    "hesai_ros_driver/msg/UdpFrame": _replayed("packets of Hesai", "HesaiLidar_ROS_2.0"),
    "nebula_msgs/msg/NebulaPackets": _replayed("packets as Autoware's Nebula records them", "nebula_ros"),
    "pandar_msgs/msg/PandarScan": _replayed("packets of Hesai", "nebula_ros, or pandar_pointcloud of ROS 1,"),
    "rslidar_msg/msg/RslidarPacket": _replayed("packets of RoboSense", "rslidar_sdk"),
    "rslidar_msgs/msg/rslidarScan": _replayed("packets of RoboSense", "ros_rslidar"),
}
"""Message type -> what it is, and what to do about it."""


def missing_decoder(message_type: str, encoding: str) -> str:
    """What to do about packets that cannot be read here; empty for every other type."""
    if encoding in (OUSTER_TURN, OTHER_PACKETS):
        return ""
    if message_type == "velodyne_msgs/msg/VelodyneScan" and _has_velodyne_decoder():
        return ""
    if message_type in OUSTER_TYPES and has_ouster_decoder():
        return _OUSTER_ALONE
    return PACKET_TYPES.get(message_type, "")


@cache
def has_ouster_decoder() -> bool:
    """Whether an `ouster-sdk` can be imported that has what is used of it."""
    try:
        from ouster.sdk import core
    except ImportError:
        return False
    return hasattr(core, "LidarFrame")


@cache
def _has_velodyne_decoder() -> bool:
    return find_spec("velodyne_decoder") is not None
