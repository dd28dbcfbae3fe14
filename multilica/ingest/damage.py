# SPDX-License-Identifier: Apache-2.0
"""Damaged bytes as one sentence."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from multilica.errors import MultilicaError, UnreadableSourceError

__all__ = ["DamagedRecordingError", "damage_named", "reason_of"]

_NONSENSE = "its records make no sense"
_REASONS = {
    "AssertionError": _NONSENSE,
    "AttributeError": _NONSENSE,
    "CRCValidationError": "a checksum does not match its data",
    "EndOfFile": "the file ends too early",
    "EndOfFileError": "the file ends too early",
    "IndexError": _NONSENSE,
    "KeyError": "a record refers to another that is not there",
    "MemoryError": "a record claims more memory than there is",
    "OSError": _NONSENSE,
    "OverflowError": "a record claims an impossible size",
    "PermissionError": "permission is denied",
    "RecordLengthLimitExceeded": "a record claims an impossible size",
    "RuntimeError": "compressed data cannot be unpacked",
    "StopIteration": "the file ends too early",
    "TypeError": _NONSENSE,
    "UnicodeDecodeError": _NONSENSE,
    "ZstdError": "compressed data cannot be unpacked",
    "error": _NONSENSE,
}
"""What the exceptions of the libraries mean for the user, by name, so that no library is imported for it."""


class DamagedRecordingError(UnreadableSourceError):
    """A recording cannot be read, or not beyond some place.

    Args:
        where: the file, for the message.
        reason: what is wrong, as a clause without its full stop.
    """

    def __init__(self, where: str, reason: str) -> None:
        self.where = where
        self.reason = reason
        super().__init__(f"{where} is damaged: {reason}.")


@contextmanager
def damage_named(where: str) -> Iterator[None]:
    """Turn whatever a library raises on damaged bytes into one sentence.

    Raises:
        DamagedRecordingError: the block failed.
    """
    try:
        yield
    except MultilicaError:
        raise
    except Exception as error:
        raise DamagedRecordingError(where, reason_of(error)) from error


def reason_of(error: Exception) -> str:
    """What a library's exception says, as a clause in one line."""
    text = " ".join(str(error).split()).rstrip(".")
    if "database disk image is malformed" in text:
        return "the file ends too early or was overwritten"
    return _REASONS.get(type(error).__name__) or text or type(error).__name__
