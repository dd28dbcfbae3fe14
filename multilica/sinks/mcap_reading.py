# SPDX-License-Identifier: Apache-2.0
"""What a result.mcap tells of its run."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from multilica.errors import UnreadableSourceError

__all__ = ["read_attached_document"]

_RESULT_JSON = "result.json"


def read_attached_document(path: Path) -> Mapping[str, Any]:
    """The result document that the file has attached.

    Raises:
        UnreadableSourceError: not a whole MCAP file, or not of a run.
    """
    from mcap.exceptions import McapError
    from mcap.reader import make_reader

    try:
        with path.open("rb") as file:
            reader = make_reader(file, validate_crcs=True)
            texts = [one.data for one in reader.iter_attachments() if one.name == _RESULT_JSON]
        document = json.loads(texts[-1]) if texts else None
    except (McapError, OSError, ValueError, struct.error) as error:
        raise UnreadableSourceError(f"{path} is not a whole MCAP file that can be read: {error}.") from error
    if not isinstance(document, Mapping):
        raise UnreadableSourceError(
            f"{path} does not tell of a run: no {_RESULT_JSON} is attached, as `multilica calibrate` attaches it to "
            "result.mcap; give that of a run."
        )
    return document
