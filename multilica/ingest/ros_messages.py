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
from multilica.ingest.ros_wire import WireReader, message_bytes
from multilica.pointcloud2 import PointCloud2, PointField, decode_points
from multilica.snapshot import Scan

__all__ = ["decode_cloud", "unpacked"]

_MAX_FIELDS = 1024
_OLD_NAMES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}


def decode_cloud(message: Message) -> Cloud:
    """Unpack a ``sensor_msgs/PointCloud2``; its stamp is that of the header, or the log time where that is zero.

    Raises:
        ValueError: the message is broken; the text is a predicate.
    """
    # By hand, for an object of `rosbags` takes as long to make as a third of the points take to unpack.
    reader = WireReader.of_message(message)
    stamp_ns, frame_id = reader.header()
    reader.align(4)
    height, width = reader.numbers("II")
    fields = _fields(reader)
    (is_big_endian,) = reader.numbers("B")
    reader.align(4)
    point_step, row_step = reader.numbers("II")
    layout = PointCloud2(fields, width, height, point_step, row_step, reader.octets(), big_endian=bool(is_big_endian))
    points_m, intensity = decode_points(layout)
    return Cloud(Scan(points_m, stamp_ns if stamp_ns > 0 else message.log_time_ns, intensity), frame_id)


def _fields(reader: WireReader) -> tuple[PointField, ...]:
    count = reader.uint32()
    if count > _MAX_FIELDS:
        raise ValueError(f"claims points of {count} fields; not more than {_MAX_FIELDS} are believed")
    return tuple(_field(reader) for _ in range(count))


def _field(reader: WireReader) -> PointField:
    name = reader.text()
    reader.align(4)
    return PointField(name, *reader.numbers("IBI" if reader.alignment == 1 else "IB3xI"))


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


@cache
def _ros2_types() -> Typestore:
    return get_typestore(Stores.ROS2_HUMBLE)


@cache
def _ros1_types() -> Typestore:
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    return store
