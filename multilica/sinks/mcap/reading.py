# SPDX-License-Identifier: Apache-2.0
"""Reader of the result document in a result.mcap."""

from io import SEEK_CUR
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from multilica.documents import MAX_JSON_BYTES
from multilica.errors import UnreadableSourceError
from multilica.results.document import ResultDocument, parse_result

if TYPE_CHECKING:
    from mcap.records import Attachment

_RESULT_JSON = "result.json"
_MAX_RECORD_BYTES = 4 * MAX_JSON_BYTES
"""Limit of a record of the file; only attachments and the summary are loaded."""
_CRC_BYTES = 4


def read_attached_document(path: Path) -> ResultDocument:
    """Return the result document that is attached to the file.

    Raises:
        UnreadableSourceError: not a whole MCAP file, or not of a run.
    """
    from mcap.reader import SeekingReader

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


def _require_checksum(attachment: "Attachment", file: BinaryIO) -> None:
    """Compare with the checksum that ends the record, right before the position of the file; the library skips it."""
    from mcap.data_stream import RecordBuilder

    file.seek(-_CRC_BYTES, SEEK_CUR)
    stored = file.read(_CRC_BYTES)
    record = RecordBuilder()
    attachment.write(record)
    whole: bytes = record.end()  # type: ignore[no-untyped-call]
    if any(stored) and stored != whole[-_CRC_BYTES:]:
        raise ValueError("a checksum does not match its data")
