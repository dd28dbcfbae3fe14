# SPDX-License-Identifier: Apache-2.0
"""Messages of an MCAP file that is written, and the result document in one that is read."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import SEEK_CUR
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, NamedTuple

from mcap.data_stream import RecordBuilder
from mcap.reader import SeekingReader
from mcap.records import Attachment
from mcap.writer import Writer

import multilica
from multilica.documents import MAX_JSON_BYTES
from multilica.errors import UnreadableSourceError
from multilica.results.document import ResultDocument, parse_result

_RESULT_JSON = "result.json"
_MAX_RECORD_BYTES = 4 * MAX_JSON_BYTES
"""Limit of a record of a file that is read; only attachments and the summary are loaded."""
_CRC_BYTES = 4


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


def read_attached_document(path: Path) -> ResultDocument:
    """Return the result document that is attached to the file.

    Raises:
        UnreadableSourceError: not a whole MCAP file, or not of a run.
    """
    text: bytes | None = None
    try:
        with path.open("rb") as file:
            reader = SeekingReader(file, validate_crcs=True, record_size_limit=_MAX_RECORD_BYTES)
            for attachment in reader.iter_attachments():
                if attachment.name == _RESULT_JSON:
                    _require_checksum(attachment, file)
                    text = attachment.data
    except Exception as error:
        # The library has no errors of its own for most kinds of damage.
        what = str(error) or type(error).__name__
        raise UnreadableSourceError(f"{path} is not a whole MCAP file that can be read: {what}.") from error
    if text is None:
        raise UnreadableSourceError(
            f"{path} has no {_RESULT_JSON} attached; give the result.mcap of a run of `multilica calibrate`."
        )
    return parse_result(path, text)


def _require_checksum(attachment: Attachment, file: BinaryIO) -> None:
    """Compare with the checksum that ends the record, right before the position of the file; the library skips it."""
    file.seek(-_CRC_BYTES, SEEK_CUR)
    stored = file.read(_CRC_BYTES)
    record = RecordBuilder()
    attachment.write(record)
    whole: bytes = record.end()  # type: ignore[no-untyped-call]
    if any(stored) and stored != whole[-_CRC_BYTES:]:
        raise ValueError("a checksum does not match its data")
