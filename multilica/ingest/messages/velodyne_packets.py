# SPDX-License-Identifier: Apache-2.0
"""The decoder of Velodyne's packets, with `velodyne_decoder`."""

from typing import Any

import numpy as np
import velodyne_decoder

from multilica.geometry import Float32Array
from multilica.ingest.message_types import Cloud
from multilica.ingest.messages.ros import WireReader
from multilica.ingest.recording import RawMessage, reason_of
from multilica.pointcloud2 import finite_points


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode one turn of a Velodyne, whose model is in the packets."""
    reader = WireReader.of_message(message)
    stamp_ns, frame_id = reader.header()
    packets = []
    for _ in range(reader.uint32()):
        reader.align(4)
        seconds, nanoseconds = reader.numbers("II" if reader.alignment == 1 else "iI")
        packets.append(velodyne_decoder.VelodynePacket(seconds + nanoseconds * 1e-9, bytes(reader.raw(1206))))
    points = finite_points(*_decoded(packets)[:, [0, 1, 2, 3, 6]].T)
    return Cloud(points.as_scan(stamp_ns or message.log_time_ns), frame_id)


def _decoded(packets: list[Any]) -> Float32Array:
    """Return x, y, z, intensity, time, column, ring and more (N, 7+)."""
    if not packets:
        return np.empty((0, 7), np.float32)
    # A decoder keeps the model of its first packet.
    decoder = velodyne_decoder.ScanDecoder(velodyne_decoder.Config())
    try:
        _, table = decoder.decode(velodyne_decoder.PacketVector(packets))
    except (RuntimeError, ValueError) as error:
        raise ValueError(f"cannot be unpacked: {reason_of(error)}") from error
    return np.asarray(table, np.float32)
