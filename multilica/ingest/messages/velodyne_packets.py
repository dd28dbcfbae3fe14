# SPDX-License-Identifier: Apache-2.0
"""The decoder of Velodyne's packets, with `velodyne_decoder`."""

from typing import Any

import numpy as np
import velodyne_decoder

from multilica.geometry import Float32Array
from multilica.ingest.message_types import Cloud
from multilica.ingest.messages.ros import WireReader
from multilica.ingest.recording import RawMessage
from multilica.pointcloud2 import finite_points

_FARTHEST_M = 1e4
"""The decoder drops points beyond 200 m unless told otherwise; the packets have them up to 330 m."""


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode one turn of a Velodyne, whose model is in the packets."""
    reader = WireReader.of_message(message)
    stamp_ns, frame_id = reader.header()
    packets = []
    for _ in range(reader.uint32()):
        reader.align(4)
        seconds, nanoseconds = reader.numbers("II" if reader.alignment == 1 else "iI")
        packets.append(velodyne_decoder.VelodynePacket(seconds + nanoseconds * 1e-9, bytes(reader.raw(1206))))
    x, y, z, intensity, seconds, _, ring = _decoded(packets)[:, :7].T
    points = finite_points(x, y, z, intensity, ring, seconds if message.timed else None)
    return Cloud(points.as_scan(stamp_ns or message.log_time_ns), frame_id)


def _decoded(packets: list[Any]) -> Float32Array:
    """Return x, y, z, intensity, time, column, ring and more (N, 7+)."""
    if not packets:
        return np.empty((0, 7), np.float32)
    # A decoder keeps the model of its first packet.
    decoder = velodyne_decoder.ScanDecoder(velodyne_decoder.Config(min_range=0.0, max_range=_FARTHEST_M))
    try:
        _, table = decoder.decode(velodyne_decoder.PacketVector(packets))
    except (RuntimeError, ValueError) as error:
        found = " ".join(str(error).split()).rstrip(".").replace(". ", ", ")
        raise ValueError(
            f"cannot be decoded ({found}); replay the log through the driver velodyne_pointcloud"
        ) from error
    return np.asarray(table, np.float32)
