# SPDX-License-Identifier: Apache-2.0
"""Recordings of Ouster's packets, with a message per turn in place of one per packet."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import closing
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

from multilica.ingest.damage import DamagedRecordingError
from multilica.ingest.packets import OTHER_PACKETS, OUSTER_TURN, OUSTER_TYPES, has_ouster_decoder
from multilica.ingest.recording import Message, Messages, Recording, Span, Topic
from multilica.ingest.ros_wire import WireReader

if TYPE_CHECKING:
    from multilica.ingest.ouster_packets import Sensor

__all__ = ["OusterRecording", "with_turns"]

_METADATA_TYPE = "std_msgs/msg/String"
_LOOKED_AT = 4
"""Messages of a topic; all have the same size, yet one may be broken."""


def with_turns(recording: Recording) -> Recording:
    """The recording with the turns that its packets make; itself if there are none that can be unpacked."""
    packets = [topic for topic in recording.topics if topic.message_type in OUSTER_TYPES and topic.count]
    if not packets or not has_ouster_decoder():
        return recording
    metadata = {topic.name: text for topic in packets if (text := _metadata_beside(recording, topic))}
    return OusterRecording(recording, metadata) if metadata else recording


class OusterRecording:
    """A recording, of which the packets of each turn are joined.

    Args:
        recording: closed together with this one.
        metadata: topic of packets -> what its driver published beside it.
    """

    def __init__(self, recording: Recording, metadata: dict[str, str]) -> None:
        self._recording = recording
        self._metadata = metadata
        self.format = recording.format
        self.damage = recording.damage
        self.is_indexed = recording.is_indexed
        self.topics = tuple(self._topic(topic) for topic in recording.topics)
        self._turns = {topic.name for topic in self.topics if topic.encoding == OUSTER_TURN}

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """Of the packets."""
        return self._recording.span_ns(topics)

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """In the order of log times; that of a turn is that of its last packet."""
        turns = {topic: _Turn(self._metadata[topic]) for topic in topics if topic in self._turns}
        with closing(self._recording.messages(topics, start_ns)) as messages:
            for message in messages:
                if message.topic in turns:
                    yield from turns[message.topic].add(message)
                else:
                    yield message
        for turn in turns.values():
            yield from turn.end()

    def close(self) -> None:
        """Close the recording."""
        self._recording.close()

    def _topic(self, topic: Topic) -> Topic:
        if topic.name not in self._metadata:
            return topic
        sensor = _sensor(self._metadata[topic.name])
        if not _holds_returns(self._recording, topic, sensor):
            return replace(topic, encoding=OTHER_PACKETS)
        return replace(topic, encoding=OUSTER_TURN, count=-(-topic.count // sensor.packets_per_frame))


class _Turn:
    """The packets of one turn so far."""

    def __init__(self, metadata: str) -> None:
        self._metadata = metadata
        self._sensor = _sensor(metadata)
        self._packets: list[memoryview] = []
        self._last: Message | None = None
        self._current: int | None = None
        self._over: int | None = None
        self._begins_cut = True

    def add(self, message: Message) -> Iterator[Message]:
        """Take a packet; gives the turn that it completes, or that it shows to have ended."""
        if message.fault:
            yield replace(message, encoding=OUSTER_TURN)
            return
        packet = _packet(message)[: self._sensor.packet_bytes]
        if len(packet) < self._sensor.packet_bytes:
            return
        number = self._sensor.frame_number(packet)
        if number == self._over:
            # Late: its turn was given already.
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

    def end(self) -> Iterator[Message]:
        """What there is of the turn."""
        if self._packets and self._last is not None:
            from multilica.ingest.ouster_packets import join_packets

            yield replace(self._last, encoding=OUSTER_TURN, data=join_packets(self._metadata, self._packets))
            self._packets.clear()


def _sensor(metadata: str) -> Sensor:
    from multilica.ingest.ouster_packets import sensor_of

    return sensor_of(metadata)


def _metadata_beside(recording: Recording, packets: Topic) -> str:
    """The first message that can be read on a topic ``metadata`` of the same namespace; empty if there is none."""
    namespace = packets.name.rpartition("/")[0]
    beside = [
        topic.name
        for topic in recording.topics
        if topic.message_type == _METADATA_TYPE
        and topic.name.rpartition("/")[0] == namespace
        and "metadata" in topic.name.rpartition("/")[2]
    ]
    for message in _first_messages(recording, beside):
        try:
            text = WireReader.of_message(message).text()
            _sensor(text)
        except ValueError:
            continue
        return text
    return ""


def _holds_returns(recording: Recording, packets: Topic, sensor: Sensor) -> bool:
    """Rather than packets of the IMU; old drivers add a byte to each."""
    sizes = [len(_packet(message)) for message in _first_messages(recording, [packets.name])]
    return any(size - sensor.packet_bytes in (0, 1) for size in sizes)


def _first_messages(recording: Recording, topics: Collection[str]) -> list[Message]:
    try:
        with closing(recording.messages(topics)) as messages:
            return list(islice(messages, _LOOKED_AT)) if topics else []
    except DamagedRecordingError:
        return []


def _packet(message: Message) -> memoryview:
    """The packet in a ``PacketMsg``; empty if it is broken."""
    try:
        return WireReader.of_message(message).octets()
    except ValueError:
        return memoryview(b"")
