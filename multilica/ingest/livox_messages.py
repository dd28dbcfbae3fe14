# SPDX-License-Identifier: Apache-2.0
"""Point clouds of Livox's drivers."""

from __future__ import annotations

import struct
from dataclasses import dataclass

import numpy as np

from multilica.ingest.cloud import Cloud
from multilica.ingest.recording import Message
from multilica.ingest.ros_messages import message_bytes
from multilica.pointcloud2 import PointField, finite_points, point_dtype
from multilica.snapshot import Scan

__all__ = ["decode_cloud"]

_FIELDS = (PointField("x", 4, 7), PointField("y", 8, 7), PointField("z", 12, 7), PointField("intensity", 16, 2))
_POINT_BYTES = 19
"""offset_time, x, y, z, reflectivity, tag, line."""
_CUT_OFF = "cannot be unpacked: it ends too early"


def decode_cloud(message: Message) -> Cloud:
    """Unpack a ``CustomMsg``, of ROS 1 or ROS 2, all points at once.

    Raises:
        ValueError: the message is broken; the text is a predicate.
    """
    data = message_bytes(message)
    reader = _ros1_reader(data) if message.encoding == "ros1" else _cdr_reader(data)
    seconds, nanoseconds = reader.numbers("II")
    frame_id = reader.text()
    reader.align(8)
    (timebase_ns,) = reader.numbers("Q")
    reader.skip(8)  # point_num, lidar_id, three reserved bytes
    (count,) = reader.numbers("I")
    # CDR aligns each point to four bytes, and does not fill up the last one.
    step = -(-_POINT_BYTES // reader.alignment) * reader.alignment
    needed = (count - 1) * step + _POINT_BYTES if count else 0
    if needed > reader.remaining:
        raise ValueError(f"claims {count} points, which take {needed} bytes, yet holds {reader.remaining}")
    dtype = point_dtype(_FIELDS, _POINT_BYTES, big_endian=reader.order == ">")
    points = np.ndarray((count,), dtype, data, reader.place, (step,)) if count else np.empty(0, dtype)
    points_m, intensity = finite_points(points["x"], points["y"], points["z"], points["intensity"])
    stamp_ns = seconds * 10**9 + nanoseconds or timebase_ns or message.log_time_ns
    return Cloud(Scan(points_m, stamp_ns, intensity), frame_id.strip("/"))


@dataclass(slots=True)
class _Reader:
    """Numbers one after the other.

    Args:
        start: from where alignment counts.
        alignment: of numbers of four bytes; 1 where nothing is aligned.
    """

    data: memoryview
    order: str
    alignment: int
    start: int
    place: int

    @property
    def remaining(self) -> int:
        return len(self.data) - self.place

    def numbers(self, codes: str) -> tuple[int, ...]:
        layout = struct.Struct(self.order + codes)
        if layout.size > self.remaining:
            raise ValueError(_CUT_OFF)
        found = layout.unpack_from(self.data, self.place)
        self.place += layout.size
        return found

    def text(self) -> str:
        (length,) = self.numbers("I")
        if length > self.remaining:
            raise ValueError(_CUT_OFF)
        text = bytes(self.data[self.place : self.place + length])
        self.place += length
        return text.rstrip(b"\0").decode(errors="replace")

    def align(self, size: int) -> None:
        if self.alignment > 1:
            self.place += (self.start - self.place) % size

    def skip(self, size: int) -> None:
        self.place += size


def _ros1_reader(data: memoryview) -> _Reader:
    sequence_bytes = 4
    return _Reader(data, "<", 1, 0, sequence_bytes)


def _cdr_reader(data: memoryview) -> _Reader:
    encapsulation_bytes = 4
    if len(data) < encapsulation_bytes:
        raise ValueError(_CUT_OFF)
    return _Reader(data, "<" if data[1] & 1 else ">", 4, encapsulation_bytes, encapsulation_bytes)
