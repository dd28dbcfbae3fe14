# SPDX-License-Identifier: Apache-2.0
"""Raw packets of LiDARs: which can be read here, and what to run for the others."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec

__all__ = ["PACKET_TYPES", "missing_decoder"]

_OUSTER = "packets of Ouster, which its driver ouster_ros turns into point clouds; replay the log through it"
_HESAI = "packets of Hesai, which its driver HesaiLidar_ROS_2.0 turns into point clouds; replay the log through it"
_ROBOSENSE = "packets of RoboSense, which its driver rslidar_sdk turns into point clouds; replay the log through it"
_VELODYNE = "packets of Velodyne; install multilica[velodyne], or replay the log through the driver velodyne_pointcloud"

PACKET_TYPES = {
    "velodyne_msgs/msg/VelodyneScan": _VELODYNE,
    "ouster_msgs/msg/PacketMsg": _OUSTER,
    "ouster_ros/msg/PacketMsg": _OUSTER,
    "ouster_sensor_msgs/msg/PacketMsg": _OUSTER,
    "hesai_lidar/msg/PandarScan": _HESAI,
    "hesai_ros_driver/msg/UdpFrame": _HESAI,
    "pandar_msgs/msg/PandarScan": _HESAI,
    "rslidar_msg/msg/RslidarPacket": _ROBOSENSE,
    "rslidar_msgs/msg/rslidarScan": _ROBOSENSE,
}
"""Message type -> what it is, and what to do about it."""


def missing_decoder(message_type: str) -> str:
    """What to do about packets that cannot be read here; empty for every other type."""
    if message_type == "velodyne_msgs/msg/VelodyneScan" and _has_velodyne_decoder():
        return ""
    return PACKET_TYPES.get(message_type, "")


@cache
def _has_velodyne_decoder() -> bool:
    return find_spec("velodyne_decoder") is not None
