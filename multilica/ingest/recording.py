# SPDX-License-Identifier: Apache-2.0
"""The interface of an open recording, the same for every format, and what its damage is called."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TypeAlias

from multilica.errors import MultilicaError, UnreadableSourceError, escape_controls

Span = tuple[int, int]
"""Log times of the first and the last message, in nanoseconds."""
ProgressObserver = Callable[[int, int], None]
"""Called with how many parts of a long read are done, and of how many."""
MessageObserver = Callable[[str, int], None]
"""Called with a topic of a running vehicle and the number of its messages so far."""

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


@dataclass(frozen=True, slots=True)
class Topic:
    """A stream of messages of one type.

    Args:
        name: topic; for point files, the name of the file or folder.
        message_type: ROS 2 notation, ``package/msg/Name``, also for ROS 1.
        encoding: of the messages' bytes, for instance ``cdr``, ``ros1`` or ``pcd``.
        lidar: the LiDAR's name in the recording; empty to name it after its frame id.
    """

    name: str
    message_type: str
    encoding: str
    count: int = 0
    lidar: str = ""

    def message(self, log_time_ns: int, data: bytes | memoryview, source: object, *, fault: str = "") -> RawMessage:
        """Return a message on this topic; `source` is the file, for error messages."""
        origin = f"In {source}, a scan of '{self.name}'"
        return RawMessage(self.name, self.message_type, self.encoding, log_time_ns, data, origin, self.lidar, fault)


@dataclass(frozen=True, slots=True, eq=False)
class RawMessage:
    """One message as stored in the recording, not decoded yet.

    Args:
        log_time_ns: when it was recorded; 0 if the format has no time.
        origin: start of a sentence about this message, for instance its file.
        lidar: as in `Topic`.
        fault: why its data cannot be read, as a predicate; empty if they can.
        timed: the times of its points are wanted, too.
    """

    topic: str
    message_type: str
    encoding: str
    log_time_ns: int
    data: bytes | memoryview
    origin: str
    lidar: str = ""
    fault: str = ""
    timed: bool = False


Messages: TypeAlias = Generator[RawMessage, None, None]
"""Messages; closing the generator releases the file."""


class Recording(ABC):
    """An open recording.

    Args:
        format: the format's name for the user, for instance ``MCAP``.
        topics: every topic, by name.
        damage: why part of the recording is missing ("the file ends too early"); empty if nothing is known to be.
        is_indexed: messages from some time on can be read without earlier ones.
    """

    format: str
    topics: tuple[Topic, ...]
    damage: str = ""
    is_indexed: bool = True

    def span_ns(self, topics: Collection[str]) -> Span | None:  # noqa: ARG002 - for the formats that have times
        """Return when these topics begin and end; None without messages or without time."""
        return None

    @abstractmethod
    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """Yield the messages on these topics that were logged at `start_ns` or later, oldest first.

        Raises:
            DamagedRecordingError: nothing more can be read; what came before is valid.
        """

    def close(self) -> None:  # noqa: B027 - not every format keeps a file open
        """Close the files."""


def normal_type(message_type: str) -> str:
    """Return ``package/msg/Name`` for ROS 1's ``package/Name``; other names unchanged."""
    package, slash, name = message_type.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else message_type


def joint_span(spans: Iterable[Span | None]) -> Span | None:
    """Return the span from the earliest beginning to the latest end; None if there is none."""
    known = [span for span in spans if span is not None]
    return (min(first for first, _ in known), max(last for _, last in known)) if known else None


def joint_topics(counts: Iterable[tuple[Topic, int]]) -> tuple[Topic, ...]:
    """Add up numbers of messages by topic, sorted by name; the topics' own counts are ignored."""
    totals: Counter[Topic] = Counter()
    for topic, count in counts:
        totals[replace(topic, count=0)] += count
    found = (replace(topic, count=count) for topic, count in totals.items())
    return tuple(sorted(found, key=lambda topic: (topic.name, topic.message_type, topic.encoding, topic.lidar)))


def sanitize_text(value: object) -> str:
    """Return the value as valid UTF-8 text: lone surrogates become question marks, control characters escapes."""
    return escape_controls(str(value).encode("utf-8", "replace").decode("utf-8"))


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
