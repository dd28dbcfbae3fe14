# SPDX-License-Identifier: Apache-2.0
"""ROS messages as they lie in recordings."""

from __future__ import annotations

from functools import cache
from typing import Any

from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from multilica.ingest.cloud import Cloud
from multilica.ingest.damage import reason_of
from multilica.ingest.recording import Message
from multilica.ingest.unpacking import ZSTD_MAGIC, unpack_zstd_message
from multilica.pointcloud2 import PointCloud2, PointField, decode_points
from multilica.snapshot import Scan

__all__ = ["decode_cloud", "message_bytes", "unpacked"]

_OLD_NAMES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


def decode_cloud(message: Message) -> Cloud:
    """Unpack a ``sensor_msgs/PointCloud2``; its stamp is that of the header, or the log time where that is zero.

    Raises:
        ValueError: the message is broken; the text is a predicate.
    """
    found = unpacked(message)
    points_m, intensity = decode_points(
        PointCloud2(
            fields=tuple(PointField(field.name, field.offset, field.datatype, field.count) for field in found.fields),
            width=found.width,
            height=found.height,
            point_step=found.point_step,
            row_step=found.row_step,
            data=found.data,
            big_endian=found.is_bigendian,
        )
    )
    stamp_ns = found.header.stamp.sec * 10**9 + found.header.stamp.nanosec
    scan = Scan(points_m, stamp_ns if stamp_ns > 0 else message.log_time_ns, intensity)
    return Cloud(scan, found.header.frame_id.strip("/"))


def unpacked(message: Message) -> Any:  # noqa: ANN401 - the classes are made by rosbags at run time
    """The message as an object of `rosbags`; arrays are views of the message's bytes.

    Raises:
        ValueError: the bytes are no such message; the text is a predicate.
    """
    message_type = _OLD_NAMES.get(message.message_type, message.message_type)
    data = message_bytes(message)
    try:
        if message.encoding == "ros1":
            return _ros1_types().deserialize_ros1(data, message_type)
        return _ros2_types().deserialize_cdr(data, message_type)
    except SerdeError as error:
        raise ValueError(f"cannot be unpacked: {reason_of(error)}") from error


def message_bytes(message: Message) -> memoryview:
    """The serialised message, unpacked where the bag has message compression.

    Raises:
        ValueError: it cannot be unpacked; the text is a predicate.
    """
    # A bag with message compression says so in its metadata.yaml only; a serialised message never begins like this.
    if message.data[:4] != ZSTD_MAGIC:
        return memoryview(message.data)
    try:
        return unpack_zstd_message(message.data)
    except ValueError as error:
        raise ValueError(f"cannot be unpacked: {error}") from error


@cache
def _ros2_types() -> Typestore:
    return get_typestore(Stores.ROS2_HUMBLE)


@cache
def _ros1_types() -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    return store
