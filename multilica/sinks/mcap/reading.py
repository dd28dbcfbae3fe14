# SPDX-License-Identifier: Apache-2.0
"""Reader of the result document in a result.mcap."""

import struct
from pathlib import Path

from multilica.errors import UnreadableSourceError
from multilica.results.document import ResultDocument, parse_result

__all__ = ["read_attached_document"]

_RESULT_JSON = "result.json"


def read_attached_document(path: Path) -> ResultDocument:
    """Return the result document that is attached to the file.

    Raises:
        UnreadableSourceError: not a whole MCAP file, or not of a run.
    """
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            texts = [one.data for one in reader.iter_attachments() if one.name == _RESULT_JSON]
    except (McapError, OSError, ValueError, struct.error) as error:
        raise UnreadableSourceError(f"{path} is not a whole MCAP file that can be read: {error}.") from error
    if not texts:
        raise UnreadableSourceError(
            f"{path} has no {_RESULT_JSON} attached; give the result.mcap of a run of `multilica calibrate`."
        )
    return parse_result(path, texts[-1])
