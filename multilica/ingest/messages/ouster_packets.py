# SPDX-License-Identifier: Apache-2.0
"""The decoder of Ouster's packets, with `ouster-sdk`."""

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from ouster.sdk import core

from multilica.geometry import FloatArray
from multilica.ingest.message_types import Cloud
from multilica.ingest.recording import RawMessage
from multilica.pointcloud2 import finite_points
from multilica.snapshot import Scan

_FRAME_ID = "os_lidar"
"""Default frame of the driver's clouds, which is also in /tf_static."""
_LENGTH = struct.Struct("<I")
_MAX_COLUMNS, _MAX_ROWS = 8192, 512

core.init_logger("off")


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """The layout of a sensor's packets, from its metadata.

    Args:
        info, layout: `SensorInfo` and `PacketFormat` of `ouster-sdk`.
        packet_bytes: size of a packet of returns; those of the IMU have another size.
        packets_per_frame: number of packets of a turn.
    """

    info: Any
    layout: Any
    packet_bytes: int
    packets_per_frame: int

    def frame_number(self, packet: memoryview) -> int:
        """Return the number of the turn of a packet."""
        return int(self.layout.frame_id(np.frombuffer(packet, np.uint8)))


@lru_cache(maxsize=16)
def sensor_of(metadata: str) -> Sensor:
    """Parse the driver's JSON; raise ValueError, with a predicate as its text, if it is not valid."""
    try:
        info = core.SensorInfo(metadata)
        layout = core.PacketFormat(info)
    except (RuntimeError, ValueError, TypeError, IndexError, MemoryError) as error:
        raise ValueError("are not metadata of an Ouster") from error
    shape = info.format
    if not (0 < shape.columns_per_frame <= _MAX_COLUMNS and 0 < shape.pixels_per_column <= _MAX_ROWS):
        raise ValueError(f"claim a frame of {shape.columns_per_frame} x {shape.pixels_per_column} points")
    if not 0 < shape.columns_per_packet <= shape.columns_per_frame:
        raise ValueError(f"claim packets of {shape.columns_per_packet} columns")
    if not core.LidarFrame(info).has_field(core.ChanField.RANGE):
        raise ValueError(f"are of a sensor whose packets have no ranges: {shape.udp_profile_lidar}")
    return Sensor(info, layout, layout.lidar_packet_size, shape.lidar_packets_per_frame())


def join_packets(metadata: str, packets: Sequence[memoryview]) -> bytes:
    """Return the packets of one turn as the data of one message for `decode_cloud`."""
    head = metadata.encode()
    return b"".join((_LENGTH.pack(len(head)), head, *packets))


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode one turn: first returns in the driver's frame ``os_lidar``, signal as intensity."""
    data = memoryview(message.data)
    (head_bytes,) = _LENGTH.unpack_from(data)
    metadata = str(data[_LENGTH.size : _LENGTH.size + head_bytes], "utf-8")
    sensor = sensor_of(metadata)
    frame = _frame(sensor, data[_LENGTH.size + head_bytes :])
    seen = frame.field(core.ChanField.RANGE) > 0
    in_sensor_m, T_sensor_lidar = _directions(metadata)
    x, y, z = ((in_sensor_m(frame) - T_sensor_lidar[:3, 3]) @ T_sensor_lidar[:3, :3])[seen].T
    signals = (core.ChanField.SIGNAL, core.ChanField.REFLECTIVITY, core.ChanField.RANGE)
    signal = frame.field(next(name for name in signals if frame.has_field(name)))
    points_m, intensity = finite_points(x, y, z, signal[seen])
    stamps_ns = frame.timestamp[frame.timestamp > 0]
    stamp_ns = int(stamps_ns[0]) if len(stamps_ns) else message.log_time_ns
    return Cloud(Scan(points_m, stamp_ns, intensity), _FRAME_ID)


def _frame(sensor: Sensor, packets: memoryview) -> Any:  # noqa: ANN401 - the class is the library's
    frame, batcher = core.LidarFrame(sensor.info), core.FrameBatcher(sensor.info)
    for start in range(0, len(packets), sensor.packet_bytes):
        packet = core.LidarPacket(sensor.layout)
        packet.buf[:] = np.frombuffer(packets[start : start + sensor.packet_bytes], np.uint8)
        try:
            batcher.batch(packet, frame)
        except (RuntimeError, ValueError) as error:
            raise ValueError("cannot be unpacked: its packets contradict the sensor's metadata") from error
    return frame


@lru_cache(maxsize=16)
def _directions(metadata: str) -> tuple[Any, FloatArray]:
    info = sensor_of(metadata).info
    T_sensor_lidar = np.array(info.lidar_to_sensor_transform, np.float64)
    T_sensor_lidar[:3, 3] /= 1000.0  # from millimetres
    return core.XYZLut(info), T_sensor_lidar
