# SPDX-License-Identifier: Apache-2.0
"""Complete part of a recording that was cut off."""

import shutil
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

__all__ = ["whole_part"]

# An RRD file is a head, then messages: kind and length, 64 bits each, little-endian, then so many bytes. A message of
# kind 0 ends the stream; the reader refuses a file that ends within a message.
_MAGIC = b"RRF2"
_HEAD_BYTES = 12
_MESSAGE_HEAD = struct.Struct("<QQ")
_KNOWN_KINDS = range(1, 4)


@contextmanager
def whole_part(path: Path) -> Iterator[Path]:
    """Provide a file with all complete messages of a recording: the file itself if it was not cut off.

    A file that is no recording is provided as it is, and the reader refuses it.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        end = _end_of_whole_messages(file, size)
        if end is None:
            yield path
            return
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / path.name
            file.seek(0)
            with copy.open("wb") as kept:
                shutil.copyfileobj(file, kept)
                kept.truncate(end)
            yield copy


def _end_of_whole_messages(file: BinaryIO, size: int) -> int | None:
    """Return where the last complete message ends; None if the file is complete, or no recording."""
    if file.read(_HEAD_BYTES)[: len(_MAGIC)] != _MAGIC:
        return None
    at = _HEAD_BYTES
    while at < size:
        file.seek(at)
        head = file.read(_MESSAGE_HEAD.size)
        if len(head) < _MESSAGE_HEAD.size:
            return at
        kind, length = _MESSAGE_HEAD.unpack(head)
        after = at + _MESSAGE_HEAD.size + length
        if kind == 0 and after <= size:
            return None
        if kind not in _KNOWN_KINDS or after > size:
            return at
        at = after
    return None
