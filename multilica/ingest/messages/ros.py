# SPDX-License-Identifier: Apache-2.0
"""The decoder of ROS messages."""

from __future__ import annotations

import struct
from functools import cache
from typing import TYPE_CHECKING, Any

from multilica.ingest.damage import reason_of
from multilica.ingest.messages.cloud import Cloud
from multilica.ingest.messages.ros_wire import WireReader, message_bytes
from multilica.ingest.recording import RawMessage
from multilica.pointcloud2 import PointCloud2, PointField, decode_points
from multilica.snapshot import Scan

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

_MAX_FIELDS = 1024
_OLD_NAMES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}
_PACKET_BYTES = 1206
_VELODYNE = {
    "velodyne_msgs/msg/VelodynePacket": f"{{time}} stamp\nuint8[{_PACKET_BYTES}] data",
    "velodyne_msgs/msg/VelodyneScan": "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets",
}


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode a ``sensor_msgs/PointCloud2``; the stamp is that of the header, or the log time if that is zero."""
    # `rosbags` would take a third of the time that the points take.
    reader = WireReader.of_message(message)
    stamp_ns, frame_id = reader.header()
    reader.align(4)
    height, width = reader.numbers("II")
    count = reader.uint32()
    if count > _MAX_FIELDS:
        raise ValueError(f"claims points of {count} fields; the limit is {_MAX_FIELDS}")
    fields = tuple(_field(reader) for _ in range(count))
    (is_big_endian,) = reader.numbers("B")
    reader.align(4)
    point_step, row_step = reader.numbers("II")
    layout = PointCloud2(fields, width, height, point_step, row_step, reader.octets(), big_endian=bool(is_big_endian))
    points_m, intensity = decode_points(layout)
    return Cloud(Scan(points_m, stamp_ns if stamp_ns > 0 else message.log_time_ns, intensity), frame_id)


def _field(reader: WireReader) -> PointField:
    name = reader.text()
    reader.align(4)
    return PointField(name, *reader.numbers("IBI" if reader.alignment == 1 else "IB3xI"))


def deserialize(message: RawMessage) -> Any:  # noqa: ANN401 - the classes are made by rosbags at run time
    """Return an object of `rosbags`; raise ValueError, with a predicate as its text, if the message is broken."""
    from rosbags.serde import SerdeError

    message_type = _OLD_NAMES.get(message.message_type, message.message_type)
    data, types = message_bytes(message), _types(message.encoding)
    try:
        if message.encoding == "ros1":
            return types.deserialize_ros1(data, message_type)
        return types.deserialize_cdr(data, message_type)
    except (SerdeError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError, struct.error) as error:
        raise ValueError(f"cannot be unpacked: {reason_of(error)}") from error


@cache
def _types(encoding: str) -> Typestore:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    is_ros1 = encoding == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.ROS2_HUMBLE)
    if is_ros1:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    for name, definition in _VELODYNE.items():
        time = "time" if is_ros1 else "builtin_interfaces/Time"
        store.register(get_types_from_msg(definition.format(time=time), name))
    return store
