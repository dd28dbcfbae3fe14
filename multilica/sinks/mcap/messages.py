# SPDX-License-Identifier: Apache-2.0
"""Messages of an MCAP file."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any, BinaryIO

from mcap.writer import Writer

import multilica


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


@dataclass(slots=True, eq=False)
class MessageWriter:
    """Writer of messages that registers each schema and channel once."""

    writer: Writer
    _schemas: dict[MessageSchema, int] = field(default_factory=dict)
    _channels: dict[str, int] = field(default_factory=dict)
    _sequence: int = 0

    def write(self, message: McapMessage, stamp_ns: int) -> None:
        """Add a message, logged and published at that time."""
        schema, topic = message.schema, message.topic
        if schema not in self._schemas:
            self._schemas[schema] = self.writer.register_schema(schema.name, schema.encoding, schema.data)
        if topic not in self._channels:
            channel = (topic, schema.message_encoding, self._schemas[schema], dict(message.metadata))
            self._channels[topic] = self.writer.register_channel(*channel)
        self.writer.add_message(self._channels[topic], stamp_ns, message.data, stamp_ns, self._sequence)
        self._sequence += 1


@contextmanager
def mcap_messages(file: BinaryIO, profile: str, **options: Any) -> Iterator[MessageWriter]:  # noqa: ANN401 - of Writer
    """Write an MCAP file with checksums, complete when the block ends."""
    writer = Writer(file, enable_data_crcs=True, **options)
    writer.start(profile=profile, library=f"multilica {multilica.__version__}")
    yield MessageWriter(writer)
    writer.finish()  # type: ignore[no-untyped-call]
