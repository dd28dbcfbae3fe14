# SPDX-License-Identifier: Apache-2.0
"""The errors that multilica raises.

::

    MultilicaError
    ├── UsageError                  the request itself is wrong             exit code 2
    │   ├── ConfigError             a key, value or file of the configuration
    │   └── UnknownNameError        a topic, LiDAR, preset or stage that does not exist
    ├── InputError                  the recording cannot be used            exit code 3
    │   ├── SourceNotFoundError     nothing at that path
    │   ├── UnreadableSourceError   broken, truncated, or not what its name says
    │   ├── UnfitSnapshotError      readable, yet nothing that can be calibrated
    │   └── UnfitPriorError         readable, yet no poses of this rig's LiDARs
    ├── StorageError                a disk or bucket is full or refuses     exit code 1
    ├── MissingDependencyError      an optional library is not installed    exit code 1
    ├── ViewerError                 no viewer can be shown on this machine  exit code 1
    └── WorkerDiedError             a worker process was killed or crashed  exit code 1

Each message is one sentence that says what was found, where, what was expected and what to do. Names and values in it
may come from a file, so that its length is bounded and characters that a terminal would obey are escaped.
"""

import difflib
from collections.abc import Iterable, Sequence
from typing import Self

_MAX_MESSAGE = 500
_TAIL = 150
_MAX_COMPARED = 100
_MOST_LISTED, _FIRST_LISTED = 20, 5


def escape_controls(text: str) -> str:
    """Return a text in one line, with what cannot be printed as escapes: controls, also those of the direction."""
    return text if text.isprintable() else "".join(each if each.isprintable() else _escaped(each) for each in text)


def _escaped(character: str) -> str:
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"


def listed(names: Sequence[str]) -> str:
    """Return names for a sentence: a few as they are, of many the first ones and the number of the others."""
    if len(names) <= _MOST_LISTED:
        return ", ".join(names)
    return f"{', '.join(names[:_FIRST_LISTED])} and {len(names) - _FIRST_LISTED} more"


class MultilicaError(Exception):
    """Base of every error that multilica raises on purpose; a long message loses its middle."""

    def __init__(self, message: str) -> None:
        text = escape_controls(message)
        if len(text) > _MAX_MESSAGE:
            text = f"{text[: _MAX_MESSAGE - _TAIL - 5]} ... {text[-_TAIL:]}"
        super().__init__(text)


class UsageError(MultilicaError):
    """A wrong request."""


class ConfigError(UsageError):
    """A wrong key, value or file of the configuration."""


class UnknownNameError(UsageError):
    """An unknown name of a kind such as ``"topic"``; `where` is the place that was searched."""

    def __init__(self, kind: str, name: str, available: Iterable[str], where: str = "") -> None:
        self.available = tuple(sorted(available))
        self._arguments = kind, name, self.available, where
        place = f" in {where}" if where else ""
        close = difflib.get_close_matches(name[:_MAX_COMPARED], self.available, n=1)
        hint = f" Did you mean '{close[0]}'?" if close else ""
        super().__init__(f"There is no {kind} '{name}'{place}; available: {listed(self.available) or 'none'}.{hint}")

    def __reduce__(self) -> tuple[type[Self], tuple[str, str, tuple[str, ...], str]]:
        return type(self), self._arguments


class MissingDependencyError(MultilicaError):
    """An optional library that is not installed, or cannot be loaded."""


class InputError(MultilicaError):
    """A recording that cannot be used; `code` is the stable name of the cause, for programs."""

    code = "unusable"


class SourceNotFoundError(InputError):
    """A path that does not exist."""

    code = "not_found"


class UnreadableSourceError(InputError):
    """A source that is corrupt, truncated, or of another format than its name says."""

    code = "unreadable"


class UnfitSnapshotError(InputError):
    """A readable source that cannot be calibrated."""

    def __init__(self, message: str, code: str = "too_few_lidars") -> None:
        self.code = code
        super().__init__(message)


class UnfitPriorError(InputError):
    """A readable prior without poses between LiDARs of the snapshot."""


class UnfitRunError(InputError):
    """A readable run whose poses cannot be accepted as a reference."""


class StorageError(MultilicaError):
    """A disk or bucket that is full, read-only or refuses access; `passes` if trying again may help."""

    def __init__(self, message: str, *, passes: bool = False) -> None:
        self.passes = passes
        super().__init__(message)


class ViewerError(MultilicaError):
    """A Rerun viewer that does not start or does not respond."""


class WorkerDiedError(MultilicaError):
    """A worker process that was killed, ran out of memory or crashed."""
