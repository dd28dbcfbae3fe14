# SPDX-License-Identifier: Apache-2.0
"""Velodyne's packets, unpacked by `velodyne_decoder`."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import velodyne_decoder
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from multilica.ingest.cloud import Cloud
from multilica.ingest.damage import reason_of
from multilica.ingest.recording import Message
from multilica.ingest.ros_wire import message_bytes
from multilica.pointcloud2 import finite_points
from multilica.snapshot import Float32Array, Scan

__all__ = ["decode_cloud"]

_SCAN = "velodyne_msgs/msg/VelodyneScan"
_PACKET = "velodyne_msgs/msg/VelodynePacket"
_PACKET_BYTES = 1206


def decode_cloud(message: Message) -> Cloud:
    """Unpack one turn of a Velodyne; which model it is, the packets say themselves.

    Raises:
        ValueError: the message is broken; the text is a predicate.
    """
    scan = _unpacked(message)
    packets = [
        velodyne_decoder.VelodynePacket(packet.stamp.sec + packet.stamp.nanosec * 1e-9, bytes(packet.data))
        for packet in scan.packets
        if len(packet.data) == _PACKET_BYTES
    ]
    if len(packets) < len(scan.packets):
        raise ValueError(f"has packets of other sizes than {_PACKET_BYTES} bytes")
    table = _decoded(packets)
    points_m, intensity = finite_points(*table[:, :4].T)
    stamp_ns = scan.header.stamp.sec * 10**9 + scan.header.stamp.nanosec
    return Cloud(Scan(points_m, stamp_ns or message.log_time_ns, intensity), scan.header.frame_id.strip("/"))


def _decoded(packets: list[Any]) -> Float32Array:
    if not packets:
        return np.empty((0, 4), np.float32)
    # A decoder learns the model from the first packet, and keeps it.
    decoder = velodyne_decoder.ScanDecoder(velodyne_decoder.Config())
    try:
        _, table = decoder.decode(velodyne_decoder.PacketVector(packets))
    except (RuntimeError, ValueError) as error:
        raise ValueError(f"cannot be unpacked: {reason_of(error)}") from error
    return np.asarray(table, np.float32)


def _unpacked(message: Message) -> Any:  # noqa: ANN401 - the classes are made by rosbags at run time
    data, store = message_bytes(message), _types(message.encoding)
    try:
        return store.deserialize_ros1(data, _SCAN) if message.encoding == "ros1" else store.deserialize_cdr(data, _SCAN)
    except SerdeError as error:
        raise ValueError(f"cannot be unpacked: {reason_of(error)}") from error


@cache
def _types(encoding: str) -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    time = "time" if encoding == "ros1" else "builtin_interfaces/Time"
    store.register(get_types_from_msg(f"{time} stamp\nuint8[{_PACKET_BYTES}] data", _PACKET))
    store.register(get_types_from_msg("std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets", _SCAN))
    return store
