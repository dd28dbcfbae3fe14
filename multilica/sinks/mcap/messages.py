# SPDX-License-Identifier: Apache-2.0
"""Messages of an MCAP file."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, BinaryIO, NamedTuple

from mcap.writer import Writer

import multilica


class MessageSchema(NamedTuple):
    """Schema of a message; `encoding` is of the schema itself (``"protobuf"``), the other of messages (``"cdr"``)."""

    name: str
    encoding: str
    data: bytes
    message_encoding: str


class McapMessage(NamedTuple):
    """One message for one topic; `metadata` belongs to the topic's channel."""

    topic: str
    schema: MessageSchema
    data: bytes
    metadata: Mapping[str, str] = MappingProxyType({})


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
