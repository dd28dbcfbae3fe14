# SPDX-License-Identifier: Apache-2.0
"""Errors of libraries on damaged files as one sentence."""

from collections.abc import Iterator
from contextlib import contextmanager

from multilica.errors import MultilicaError, UnreadableSourceError

_REASONS = {
    "its records make no sense": "AssertionError AttributeError IndexError OSError TypeError UnicodeDecodeError error",
    "a checksum does not match its data": "CRCValidationError",
    "the file ends too early": "EndOfFile EndOfFileError StopIteration",
    "a record refers to another that does not exist": "KeyError",
    "a record claims more memory than there is": "MemoryError",
    "a record claims an impossible size": "OverflowError RecordLengthLimitExceeded",
    "permission is denied": "PermissionError",
    "compressed data cannot be unpacked": "RuntimeError ZstdError",
}
"""Reason -> names of exception classes; by name, so that no library is imported for it."""
_REASON_OF_CLASS = {name: reason for reason, names in _REASONS.items() for name in names.split()}


class DamagedRecordingError(UnreadableSourceError):
    """A recording cannot be read, or not beyond some point; `reason` is a clause without full stop."""

    def __init__(self, where: str, reason: str) -> None:
        self.where = where
        self.reason = reason
        super().__init__(f"{where} is damaged: {reason}.")


@contextmanager
def damage_named(where: str) -> Iterator[None]:
    """Turn any error of a library into a `DamagedRecordingError` with one sentence."""
    try:
        yield
    except MultilicaError:
        raise
    except Exception as error:
        raise DamagedRecordingError(where, reason_of(error)) from error


def reason_of(error: Exception) -> str:
    """Return the meaning of a library's exception, as a clause in one line."""
    text = " ".join(str(error).split()).rstrip(".")
    if type(error).__name__ == "InterruptError":
        return "reading it takes many more steps than its size explains"
    if "database disk image is malformed" in text:
        return "the file ends too early or was overwritten"
    return _REASON_OF_CLASS.get(type(error).__name__) or text or type(error).__name__
