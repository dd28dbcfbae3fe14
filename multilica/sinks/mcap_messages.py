# SPDX-License-Identifier: Apache-2.0
"""Messages of an MCAP file, whatever their encoding."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from mcap.writer import Writer

from multilica.geometry import RigidTransform
from multilica.sinks.drawing import Drawing
from multilica.sinks.narration import LogLine
from multilica.snapshot import Float32Array

__all__ = ["Encoding", "Message", "MessageSchema", "MessageWriter"]


@dataclass(frozen=True, slots=True)
class MessageSchema:
    """How a message's bytes are to be read.

    Args:
        encoding: of the schema itself, for instance ``"protobuf"``.
        message_encoding: of the messages, for instance ``"cdr"``.
    """

    name: str
    encoding: str
    data: bytes
    message_encoding: str


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """One message for one topic; `metadata` belongs to the topic's channel."""

    topic: str
    schema: MessageSchema
    data: bytes
    metadata: Mapping[str, str] = field(default_factory=dict)


class Encoding(Protocol):
    """How a calibration is put into messages."""

    profile: str

    def transforms(self, poses: Sequence[RigidTransform], stamp_ns: int) -> Message:
        """Static transforms."""

    def cloud(self, lidar: str, points_m: Float32Array, stamp_ns: int) -> Message:
        """Points (N, 3) of a LiDAR in the frame of its name."""

    def drawings(self, topic: str, drawings: Sequence[Drawing], stamp_ns: int) -> Message:
        """Lines, ellipsoids and labels."""

    def log(self, line: LogLine, stamp_ns: int) -> Message:
        """A line of the log."""

    def metrics(self, figures: Mapping[str, Any]) -> Message:
        """Figures of the result."""


@dataclass(slots=True, eq=False)
class MessageWriter:
    """Writes messages, each schema and channel once, before its first message."""

    writer: Writer
    _schemas: dict[MessageSchema, int] = field(default_factory=dict)
    _channels: dict[str, int] = field(default_factory=dict)
    _sequence: int = 0

    def write(self, message: Message, stamp_ns: int) -> None:
        """Add a message, logged and published at that time."""
        channel = self._channel(message)
        self.writer.add_message(channel, stamp_ns, message.data, stamp_ns, self._sequence)
        self._sequence += 1

    def _channel(self, message: Message) -> int:
        if message.topic not in self._channels:
            schema = message.schema
            self._channels[message.topic] = self.writer.register_channel(
                message.topic, schema.message_encoding, self._schema(schema), dict(message.metadata)
            )
        return self._channels[message.topic]

    def _schema(self, schema: MessageSchema) -> int:
        if schema not in self._schemas:
            found = self.writer.register_schema(schema.name, schema.encoding, schema.data)
            self._schemas[schema] = int(found)
        return self._schemas[schema]
