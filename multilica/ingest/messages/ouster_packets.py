# SPDX-License-Identifier: Apache-2.0
"""Ouster's packets, with `ouster-sdk`: joined to one message per turn of the LiDAR, and decoded."""

import struct
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from typing import Any

import numpy as np
from ouster.sdk import core

from multilica.geometry import FloatArray
from multilica.ingest.message_types import OTHER_PACKETS, OUSTER_TURN, Cloud
from multilica.ingest.messages.ros import WireReader
from multilica.ingest.recording import DamagedRecordingError, Messages, RawMessage, Recording, Span, Topic
from multilica.pointcloud2 import finite_points

_FRAME_ID = "os_lidar"
"""Default frame of the driver's clouds, which is also in /tf_static."""
_LENGTH = struct.Struct("<I")
_MAX_COLUMNS, _MAX_ROWS = 8192, 512

_MAX_TRIES = 4
"""Messages of a topic to try; all have the same size, yet one may be broken."""

core.init_logger("off")


@dataclass(frozen=True, slots=True, eq=False)
class _Sensor:
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
def _sensor_of(metadata: str) -> _Sensor:
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
    return _Sensor(info, layout, layout.lidar_packet_size, shape.lidar_packets_per_frame())


def decode_cloud(message: RawMessage) -> Cloud:
    """Decode one turn: first returns in the driver's frame ``os_lidar``, signal as intensity."""
    data = memoryview(message.data)
    (head_bytes,) = _LENGTH.unpack_from(data)
    metadata = str(data[_LENGTH.size : _LENGTH.size + head_bytes], "utf-8")
    sensor = _sensor_of(metadata)
    frame = _frame(sensor, data[_LENGTH.size + head_bytes :])
    seen = frame.field(core.ChanField.RANGE) > 0
    in_sensor_m, T_sensor_lidar = _directions(metadata)
    x, y, z = ((in_sensor_m(frame) - T_sensor_lidar[:3, 3]) @ T_sensor_lidar[:3, :3])[seen].T
    signals = (core.ChanField.SIGNAL, core.ChanField.REFLECTIVITY, core.ChanField.RANGE)
    signal = frame.field(next(name for name in signals if frame.has_field(name)))
    rows, columns = np.nonzero(seen)
    points = finite_points(x, y, z, signal[seen], rows, frame.timestamp[columns] if message.timed else None)
    stamps_ns = frame.timestamp[frame.timestamp > 0]
    stamp_ns = int(stamps_ns[0]) if len(stamps_ns) else message.log_time_ns
    return Cloud(points.as_scan(stamp_ns), _FRAME_ID)


def _frame(sensor: _Sensor, packets: memoryview) -> Any:  # noqa: ANN401 - the class is the library's
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
    info = _sensor_of(metadata).info
    T_sensor_lidar = np.array(info.lidar_to_sensor_transform, np.float64)
    T_sensor_lidar[:3, 3] /= 1000.0  # from millimetres
    return core.XYZLut(info), T_sensor_lidar


def with_turns(recording: Recording, packets: Sequence[Topic]) -> Recording:
    """Return the recording with the packets on these topics joined to turns; itself if none can be decoded."""
    metadata = {topic.name: text for topic in packets if (text := _metadata_beside(recording, topic))}
    return _OusterRecording(recording, metadata) if metadata else recording


class _OusterRecording(Recording):
    """A recording with the packets of each turn joined; `metadata` is the driver's JSON by topic of packets."""

    def __init__(self, recording: Recording, metadata: dict[str, str]) -> None:
        self.format = recording.format
        self.damage = recording.damage
        self.is_indexed = recording.is_indexed
        self._recording = recording
        self._metadata = metadata
        self.topics = tuple(self._topic(topic) for topic in recording.topics)
        self._turns = {topic.name for topic in self.topics if topic.encoding == OUSTER_TURN}

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Return when these topics begin and end."""
        return self._recording.span_ns(topics)

    def close(self) -> None:
        """Close the recording of packets."""
        self._recording.close()

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield messages by log time; the log time of a turn is that of its last packet."""
        turns = {topic: _Turn(self._metadata[topic]) for topic in topics if topic in self._turns}
        with closing(self._recording.messages(topics, start_ns)) as messages:
            for message in messages:
                if message.topic in turns:
                    yield from turns[message.topic].add(message)
                else:
                    yield message
        for turn in turns.values():
            yield from turn.end()

    def _topic(self, topic: Topic) -> Topic:
        if topic.name not in self._metadata:
            return topic
        sensor = _sensor_of(self._metadata[topic.name])
        sizes = [len(_packet(message)) for message in _first_messages(self._recording, [topic.name])]
        # Old drivers add a byte to each packet; packets of the IMU are far smaller.
        if not any(size - sensor.packet_bytes in (0, 1) for size in sizes):
            return replace(topic, encoding=OTHER_PACKETS)
        return replace(topic, encoding=OUSTER_TURN, count=-(-topic.count // sensor.packets_per_frame))


class _Turn:
    """The packets of one turn so far."""

    def __init__(self, metadata: str) -> None:
        self._metadata = metadata
        self._sensor = _sensor_of(metadata)
        self._packets: list[memoryview] = []
        self._last: RawMessage | None = None
        self._current: int | None = None
        self._over: int | None = None
        self._begins_cut = True

    def add(self, message: RawMessage) -> Iterator[RawMessage]:
        """Add a packet; yield the turn that it completes or ends."""
        if message.fault:
            yield replace(message, encoding=OUSTER_TURN)
            return
        packet = _packet(message)[: self._sensor.packet_bytes]
        if len(packet) < self._sensor.packet_bytes:
            return
        number = self._sensor.frame_number(packet)
        if number == self._over:
            # A late packet of a turn that was already yielded.
            return
        if number != self._current:
            if not self._begins_cut:
                yield from self.end()
            self._packets.clear()
            # Reading may begin within a turn.
            self._begins_cut = self._current is None and self._over is None
            self._over, self._current = self._over if self._current is None else self._current, number
        self._packets.append(packet)
        self._last = message
        if len(self._packets) == self._sensor.packets_per_frame:
            yield from self.end()
            self._over, self._current = number, None

    def end(self) -> Iterator[RawMessage]:
        """Yield the packets of the turn so far."""
        if self._packets and self._last is not None:
            head = self._metadata.encode()
            data = b"".join((_LENGTH.pack(len(head)), head, *self._packets))
            yield replace(self._last, encoding=OUSTER_TURN, data=data)
            self._packets.clear()


def _metadata_beside(recording: Recording, packets: Topic) -> str:
    """Return the first valid message on a topic ``metadata`` of the same namespace; empty if there is none."""
    namespace = packets.name.rpartition("/")[0]
    beside = [
        topic.name
        for topic in recording.topics
        if topic.message_type == "std_msgs/msg/String"
        and topic.name.rpartition("/")[0] == namespace
        and "metadata" in topic.name.rpartition("/")[2]
    ]
    for message in _first_messages(recording, beside):
        try:
            text = WireReader.of_message(message).text()
            _sensor_of(text)
        except ValueError:
            continue
        return text
    return ""


def _first_messages(recording: Recording, topics: Collection[str]) -> list[RawMessage]:
    with suppress(DamagedRecordingError), closing(recording.messages(topics)) as messages:
        return list(islice(messages, _MAX_TRIES)) if topics else []
    return []


def _packet(message: RawMessage) -> memoryview:
    """Return the packet in a ``PacketMsg``; empty if the message is broken."""
    with suppress(ValueError):
        return WireReader.of_message(message).octets()
    return memoryview(b"")
