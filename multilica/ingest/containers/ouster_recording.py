# SPDX-License-Identifier: Apache-2.0
"""Recordings of Ouster's packets, with one message per turn of the LiDAR instead of one per packet."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import closing, suppress
from dataclasses import replace
from itertools import islice
from typing import TYPE_CHECKING

from multilica.ingest.message_types import MESSAGE_TYPES, OTHER_PACKETS, OUSTER, OUSTER_TURN, is_installed
from multilica.ingest.messages.ros import WireReader
from multilica.ingest.recording import DamagedRecordingError, Messages, RawMessage, Recording, Span, Topic

if TYPE_CHECKING:
    from multilica.ingest.messages.ouster_packets import Sensor

_MAX_TRIES = 4
"""Messages of a topic to try; all have the same size, yet one may be broken."""


def with_turns(recording: Recording) -> Recording:
    """Return the recording with its packets joined to turns; the recording itself if it has none to decode."""
    types = {name for name, entry in MESSAGE_TYPES.items() if entry.requires == OUSTER}
    packets = [topic for topic in recording.topics if topic.message_type in types and topic.count]
    if not packets or not is_installed(OUSTER):
        return recording
    metadata = {topic.name: text for topic in packets if (text := _metadata_beside(recording, topic))}
    return OusterRecording(recording, metadata) if metadata else recording


class OusterRecording(Recording):
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
        sensor = _sensor(self._metadata[topic.name])
        sizes = [len(_packet(message)) for message in _first_messages(self._recording, [topic.name])]
        # Old drivers add a byte to each packet; packets of the IMU are far smaller.
        if not any(size - sensor.packet_bytes in (0, 1) for size in sizes):
            return replace(topic, encoding=OTHER_PACKETS)
        return replace(topic, encoding=OUSTER_TURN, count=-(-topic.count // sensor.packets_per_frame))


class _Turn:
    """The packets of one turn so far."""

    def __init__(self, metadata: str) -> None:
        self._metadata = metadata
        self._sensor = _sensor(metadata)
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
            from multilica.ingest.messages.ouster_packets import join_packets

            yield replace(self._last, encoding=OUSTER_TURN, data=join_packets(self._metadata, self._packets))
            self._packets.clear()


def _sensor(metadata: str) -> Sensor:
    from multilica.ingest.messages.ouster_packets import sensor_of

    return sensor_of(metadata)


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
            _sensor(text)
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
