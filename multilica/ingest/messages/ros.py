# SPDX-License-Identifier: Apache-2.0
"""The values of serialised ROS messages, and the decoder of point clouds."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache

import numpy as np

from multilica.ingest.decompression import ZSTD_MAGIC, unpack_zstd_message
from multilica.ingest.memory import require_decodable
from multilica.ingest.message_types import Cloud
from multilica.ingest.recording import RawMessage
from multilica.pointcloud2 import PointCloud2, PointField, Points, decode_points, finite_records, point_dtype

_MAX_FIELDS = 1024
_LIVOX_FIELDS = (
    *(PointField(name, 4 + 4 * index, 7) for index, name in enumerate("xyz")),
    PointField("intensity", 16, 2),
    PointField("line", 18, 2),
    PointField("offset_time", 0, 6),
)
_LIVOX_BYTES = 19
"""offset_time, x, y, z, reflectivity, tag, line."""
_layout = cache(struct.Struct)
_CUT_OFF = "cannot be unpacked: it ends too early"
_ENCAPSULATION_BYTES = 4


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode a ``sensor_msgs/PointCloud2`` or a ``CustomMsg`` of Livox; a stamp of zero becomes the log time."""
    reader = WireReader.of_message(message)
    stamp_ns, frame_id = reader.header()
    if message.message_type.endswith("/CustomMsg"):
        timebase_ns, lidar_id, points = _livox_points(reader, timed=message.timed)
        scan = points.as_scan(stamp_ns if stamp_ns > 0 else timebase_ns or message.log_time_ns)
        return Cloud(scan, frame_id, device=f"lidar_id {lidar_id}")
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
    scan = decode_points(layout, timed=message.timed).as_scan(stamp_ns if stamp_ns > 0 else message.log_time_ns)
    return Cloud(scan, frame_id)


def _livox_points(reader: WireReader, *, timed: bool) -> tuple[int, int, Points]:
    """Read the time base in nanoseconds, the number of the LiDAR, then the points."""
    reader.align(8)
    (timebase_ns,) = reader.numbers("Q")
    _, lidar_id = reader.numbers("IB")
    reader.place += 3  # reserved
    count = reader.uint32()
    # CDR aligns each point to four bytes, without padding after the last one.
    step = -(-_LIVOX_BYTES // reader.alignment) * reader.alignment
    needed = (count - 1) * step + _LIVOX_BYTES if count else 0
    if needed > reader.remaining:
        raise ValueError(f"claims {count} points, which need {needed} bytes, but holds {reader.remaining}")
    dtype = point_dtype(_LIVOX_FIELDS, _LIVOX_BYTES, big_endian=reader.order == ">", timed=timed)
    points = np.ndarray((count,), dtype, reader.data, reader.place, (step,)) if count else np.empty(0, dtype)
    return timebase_ns, lidar_id, finite_records(points)


def _field(reader: WireReader) -> PointField:
    name = reader.text()
    reader.align(4)
    return PointField(name, *reader.numbers("IBI" if reader.alignment == 1 else "IB3xI"))


@dataclass(slots=True)
class WireReader:
    """A reader of one value after the other, without copies; the objects of `rosbags` would take longer than points.

    Every method raises ValueError, with a predicate as its text, if the message is lost, broken or ends before.

    Args:
        order: byte order, as in `struct`.
        alignment: of numbers of four bytes; 1 if nothing is aligned.
        place: position of the next value.
    """

    data: memoryview
    order: str
    alignment: int
    place: int

    @classmethod
    def of_message(cls, message: RawMessage) -> WireReader:
        """Start at the beginning of a message."""
        data = message_bytes(message)
        if message.encoding == "ros1":
            return cls(data, "<", 1, 0)
        if len(data) < _ENCAPSULATION_BYTES:
            raise ValueError(_CUT_OFF)
        return cls(data, "<" if data[1] & 1 else ">", 4, _ENCAPSULATION_BYTES)

    @property
    def remaining(self) -> int:
        """Number of bytes left; negative beyond the end."""
        return len(self.data) - self.place

    def numbers(self, codes: str) -> tuple[int, ...]:
        """Read numbers without gaps by their codes of `struct`."""
        layout = _layout(self.order + codes)
        try:
            found = layout.unpack_from(self.data, self.place)
        except struct.error as error:
            raise ValueError(_CUT_OFF) from error
        self.place += layout.size
        return found

    def header(self) -> tuple[int, str]:
        """Read stamp in nanoseconds and frame id of a ``std_msgs/Header``."""
        is_ros1 = self.alignment == 1
        if is_ros1:
            self.place += 4
        seconds, nanoseconds = self.numbers("II" if is_ros1 else "iI")
        return seconds * 10**9 + nanoseconds, self.text().strip("/")

    def uint32(self) -> int:
        """Read an aligned number of four bytes."""
        self.align(4)
        return self.numbers("I")[0]

    def float64s(self, count: int) -> tuple[float, ...]:
        """Read aligned numbers of eight bytes."""
        self.align(8)
        return self.numbers(f"{count}d")

    def text(self) -> str:
        """Read a string."""
        return str(self.octets(), "utf-8", "replace").rstrip("\0")

    def octets(self) -> memoryview:
        """Read a sequence of bytes."""
        return self.raw(self.uint32())

    def raw(self, size: int) -> memoryview:
        """Read `size` bytes."""
        begin, self.place = self.place, self.place + size
        if self.place > len(self.data):
            raise ValueError(_CUT_OFF)
        return self.data[begin : self.place]

    def align(self, size: int) -> None:
        """Skip the padding before a number of `size` bytes."""
        if self.alignment > 1:
            self.place += (_ENCAPSULATION_BYTES - self.place) % size


def message_bytes(message: RawMessage) -> memoryview:
    """Return the serialised message, unpacked if it is compressed; errors as of `WireReader`."""
    if message.fault:
        raise ValueError(message.fault)
    # Only the bag's metadata.yaml announces message compression, but a serialised message never begins like this.
    if message.data[:4] != ZSTD_MAGIC:
        return memoryview(message.data)
    try:
        unpacked = unpack_zstd_message(message.data)
    except ValueError as error:
        raise ValueError(f"cannot be unpacked: {error}") from error
    require_decodable(len(unpacked))
    return unpacked
