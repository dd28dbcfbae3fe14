# SPDX-License-Identifier: Apache-2.0
"""Reader of the result document in a result.mcap."""

from pathlib import Path

from multilica.documents import MAX_JSON_BYTES
from multilica.errors import UnreadableSourceError
from multilica.results.document import ResultDocument, parse_result

__all__ = ["read_attached_document"]

_RESULT_JSON = "result.json"
_MAX_RECORD_BYTES = 4 * MAX_JSON_BYTES
"""Limit of a record of the file; only attachments and the summary are loaded."""


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
                text = attachment.data if attachment.name == _RESULT_JSON else text
    except Exception as error:
        # The library has no errors of its own for most kinds of damage.
        what = str(error) or type(error).__name__
        raise UnreadableSourceError(f"{path} is not a whole MCAP file that can be read: {what}.") from error
    if text is None:
        raise UnreadableSourceError(
            f"{path} has no {_RESULT_JSON} attached; give the result.mcap of a run of `multilica calibrate`."
        )
    return parse_result(path, text)
