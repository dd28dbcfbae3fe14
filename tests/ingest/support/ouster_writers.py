# SPDX-License-Identifier: Apache-2.0
"""Ouster's packets, made by the encoder of `ouster-sdk`."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator

import numpy as np
from ouster.sdk import core

from tests.ingest.support.recording_writers import PERIOD_NS, START_NS

PACKET = "ouster_sensor_msgs/msg/PacketMsg"
PROFILES = {
    "legacy": core.UDPProfileLidar.LEGACY,
    "single": core.UDPProfileLidar.RNG19_RFL8_SIG16_NIR16,
    "dual": core.UDPProfileLidar.RNG19_RFL8_SIG16_NIR16_DUAL,
}

MODES = {512: core.LidarMode._512x10, 1024: core.LidarMode._1024x10}

RawMessage = tuple[str, str, int, bytes]


def sensor(profile: str = "legacy", columns: int = 1024) -> core.SensorInfo:
    """An OS-1-64."""
    table = json.loads(core.SensorInfo.from_default(MODES[columns]).to_json_string())
    table["lidar_data_format"]["udp_profile_lidar"] = PROFILES[profile].name
    table["config_params"] |= {"udp_port_lidar": 7502, "udp_port_imu": 7503}
    return core.SensorInfo(json.dumps(table))


def frame_of(info: core.SensorInfo, number: int) -> core.LidarFrame:
    """A turn whose returns are from 2 to 60 m, some missing."""
    frame = core.LidarFrame(info)
    rng = np.random.default_rng(number)
    for name in frame.fields:
        if name.startswith(("RANGE", "SIGNAL")):
            frame.field(name)[:] = rng.integers(2000, 60_000, frame.field(name).shape) & ~7
    frame.field(core.ChanField.RANGE)[:, ::7] = 0
    frame.status[:], frame.measurement_id[:] = 1, np.arange(frame.w)
    frame.timestamp[:] = START_NS + number * PERIOD_NS + np.arange(frame.w) * (PERIOD_NS // frame.w)
    frame.frame_id = number
    return frame


def packets_of(info: core.SensorInfo, frame: core.LidarFrame) -> list[bytes]:
    made = core.frame_to_packets(frame, core.PacketFormat(info), info.init_id, 0)
    return [bytes(packet.buf) for packet in made if isinstance(packet, core.LidarPacket)]


def expected_points_m(info: core.SensorInfo, frame: core.LidarFrame) -> np.ndarray:
    """In the driver's frame os_lidar, which is half a turn from the sensor's, and lower by what the metadata say."""
    in_sensor_m = core.XYZLut(info)(frame)[frame.field(core.ChanField.RANGE) > 0]
    height_m = info.lidar_to_sensor_transform[2, 3] / 1000.0
    return in_sensor_m * [-1.0, -1.0, 1.0] - [0.0, 0.0, height_m]


def ouster_messages(
    info: core.SensorInfo, frames: list[core.LidarFrame], encoding: str = "cdr", namespace: str = "/ouster"
) -> Iterator[RawMessage]:
    """As `ouster_ros` has them recorded: metadata once, packets of returns and of the IMU."""
    yield (
        f"{namespace}/metadata",
        "std_msgs/msg/String",
        START_NS,
        wire(info.to_json_string().encode() + b"\0", encoding),
    )
    for number, frame in enumerate(frames):
        packets = packets_of(info, frame)
        for index, packet in enumerate(packets):
            time_ns = START_NS + number * PERIOD_NS + index * (PERIOD_NS // len(packets))
            yield f"{namespace}/lidar_packets", PACKET, time_ns, wire(packet, encoding)
        yield f"{namespace}/imu_packets", PACKET, START_NS + number * PERIOD_NS, wire(b"\0" * 48, encoding)


def wire(octets: bytes, encoding: str) -> bytes:
    """A message with a single field of bytes or text."""
    return (b"\0\1\0\0" if encoding == "cdr" else b"") + struct.pack("<I", len(octets)) + octets
