# SPDX-License-Identifier: Apache-2.0
"""What every format offers to the reader."""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias

__all__ = ["Message", "MessageObserver", "Messages", "Recording", "Span", "Topic", "joint_span", "normal_type"]

Span = tuple[int, int]
"""Log times of the first and the last message, in nanoseconds."""
MessageObserver = Callable[[str, int], None]
"""Told of a topic of a running vehicle, and of the number of its messages so far."""


@dataclass(frozen=True, slots=True)
class Topic:
    """One stream of messages of one type.

    Args:
        name: topic, or for point files the name of the file or folder.
        message_type: ROS 2 notation, ``package/msg/Name``, also for ROS 1.
        encoding: how the bytes are to be read: ``cdr``, ``ros1``, ``pcd``, ``ply``, or another that nobody here reads.
        count: number of messages.
        lidar: what the recording itself calls the LiDAR; empty: to be named after its frame id.
    """

    name: str
    message_type: str
    encoding: str
    count: int
    lidar: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Message:
    """One message as it lies in the recording, not unpacked yet.

    Args:
        log_time_ns: when it was recorded; 0 where the format has no time.
        origin: what a sentence about this very message begins with, for instance its file.
        lidar: as of `Topic`.
        fault: why its data could not even be read, as a predicate; empty if they could.
    """

    topic: str
    message_type: str
    encoding: str
    log_time_ns: int
    data: bytes | memoryview
    origin: str
    lidar: str = ""
    fault: str = ""

    @property
    def topic_alone(self) -> Topic:
        """The topic, no messages counted."""
        return Topic(self.topic, self.message_type, self.encoding, 0, self.lidar)


Messages: TypeAlias = Generator[Message, None, None]
"""An iterator that lets go of its file when it is closed."""


class Recording(Protocol):
    """An open recording."""

    @property
    def format(self) -> str:
        """What the user calls the format, for instance ``MCAP``."""

    @property
    def topics(self) -> tuple[Topic, ...]:
        """Every topic, by name."""

    @property
    def damage(self) -> str:
        """Why less can be read than was recorded ("the file ends too early"); empty if nothing is known."""

    @property
    def is_indexed(self) -> bool:
        """Messages from some time on can be had without reading those before."""

    def span_ns(self, topics: Collection[str]) -> Span | None:
        """When these topics begin and end; None without messages, or where the format has no time."""

    def messages(self, topics: Collection[str], start_ns: int = 0) -> Messages:
        """The messages on these topics that were logged at `start_ns` or later, oldest first.

        Raises:
            DamagedRecordingError: nothing more can be read; what came before is good.
        """

    def close(self) -> None:
        """Let go of the files."""


def normal_type(message_type: str) -> str:
    """``package/msg/Name`` for ROS 1's ``package/Name``; other names as they are."""
    package, slash, name = message_type.partition("/")
    return f"{package}/msg/{name}" if slash and "/" not in name else message_type


def joint_span(spans: Mapping[str, Span], topics: Collection[str]) -> Span | None:
    """From the first message of any of these topics to the last; None if there is none."""
    chosen = [span for name, span in spans.items() if name in topics]
    return (min(first for first, _ in chosen), max(last for _, last in chosen)) if chosen else None
