# SPDX-License-Identifier: Apache-2.0
"""Messages of an MCAP file."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

from mcap.writer import Writer

from multilica.geometry import RigidTransform
from multilica.sinks.drawing.primitives import Drawing
from multilica.sinks.text.log_lines import LogLine
from multilica.snapshot import Float32Array

__all__ = ["Encoding", "McapMessage", "MessageSchema", "MessageWriter"]


@dataclass(frozen=True, slots=True)
class MessageSchema:
    """Schema of a message.

    Args:
        encoding: of the schema itself, for instance ``"protobuf"``.
        message_encoding: of the messages, for instance ``"cdr"``.
    """

    name: str
    encoding: str
    data: bytes
    message_encoding: str


@dataclass(frozen=True, slots=True, eq=False)
class McapMessage:
    """One message for one topic; `metadata` belongs to the topic's channel."""

    topic: str
    schema: MessageSchema
    data: bytes
    metadata: Mapping[str, str] = field(default_factory=dict)


class Encoding(Protocol):
    """Encoder of a calibration into messages."""

    profile: str

    def transforms(self, poses: Sequence[RigidTransform], stamp_ns: int) -> McapMessage:
        """Encode static transforms."""

    def cloud(self, lidar: str, points_m: Float32Array, stamp_ns: int) -> McapMessage:
        """Encode points (N, 3) of a LiDAR in the frame of its name."""

    def drawings(self, topic: str, drawings: Sequence[Drawing], stamp_ns: int) -> McapMessage:
        """Encode drawings."""

    def log(self, line: LogLine, stamp_ns: int) -> McapMessage:
        """Encode a log line."""

    def metrics(self, figures: Mapping[str, Any]) -> McapMessage:
        """Encode figures of the result."""


@dataclass(slots=True, eq=False)
class MessageWriter:
    """Writer of messages that registers each schema and channel once."""

    writer: Writer
    _schemas: dict[MessageSchema, int] = field(default_factory=dict)
    _channels: dict[str, int] = field(default_factory=dict)
    _sequence: int = 0

    def write(self, message: McapMessage, stamp_ns: int) -> None:
        """Add a message, logged and published at that time."""
        channel = self._channel(message)
        self.writer.add_message(channel, stamp_ns, message.data, stamp_ns, self._sequence)
        self._sequence += 1

    def _channel(self, message: McapMessage) -> int:
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
