# SPDX-License-Identifier: Apache-2.0
"""The decoder of messages of Livox's drivers."""

import numpy as np

from multilica.ingest.message_types import Cloud
from multilica.ingest.messages.ros import WireReader
from multilica.ingest.recording import RawMessage
from multilica.pointcloud2 import PointField, finite_records, point_dtype
from multilica.snapshot import Scan

_FIELDS = (PointField("x", 4, 7), PointField("y", 8, 7), PointField("z", 12, 7), PointField("intensity", 16, 2))
_POINT_BYTES = 19
"""offset_time, x, y, z, reflectivity, tag, line."""


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode a ``CustomMsg`` of ROS 1 or ROS 2."""
    reader = WireReader.of_message(message)
    stamp_ns, frame_id = reader.header()
    reader.align(8)
    (timebase_ns,) = reader.numbers("Q")
    reader.skip(8)  # point_num, lidar_id, three reserved bytes
    count = reader.uint32()
    # CDR aligns each point to four bytes, without padding after the last one.
    step = -(-_POINT_BYTES // reader.alignment) * reader.alignment
    needed = (count - 1) * step + _POINT_BYTES if count else 0
    if needed > reader.remaining:
        raise ValueError(f"claims {count} points, which need {needed} bytes, but holds {reader.remaining}")
    dtype = point_dtype(_FIELDS, _POINT_BYTES, big_endian=reader.order == ">")
    points = np.ndarray((count,), dtype, reader.data, reader.place, (step,)) if count else np.empty(0, dtype)
    points_m, intensity = finite_records(points)
    return Cloud(Scan(points_m, stamp_ns if stamp_ns > 0 else timebase_ns or message.log_time_ns, intensity), frame_id)
