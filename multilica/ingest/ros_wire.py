# SPDX-License-Identifier: Apache-2.0
"""Serialised ROS messages, value by value."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache

from multilica.ingest.recording import Message
from multilica.ingest.unpacking import ZSTD_MAGIC, unpack_zstd_message

__all__ = ["WireReader", "message_bytes"]

_layout = cache(struct.Struct)
_CUT_OFF = "cannot be unpacked: it ends too early"
_ENCAPSULATION_BYTES = 4
_SEQUENCE_BYTES = 4


@dataclass(slots=True)
class WireReader:
    """The values of a message one after the other, nothing copied.

    Every read raises ValueError, with a predicate as its text, where the message ends before.

    Args:
        order: of the bytes, as of `struct`.
        alignment: of numbers of four bytes; 1 where nothing is aligned.
        start: from where alignment counts.
        place: of the next value.
    """

    data: memoryview
    order: str
    alignment: int
    start: int
    place: int

    @classmethod
    def of_message(cls, message: Message) -> WireReader:
        """At the beginning.

        Raises:
            ValueError: the message is too short, or its compression broken; the text is a predicate.
        """
        data = message_bytes(message)
        if message.encoding == "ros1":
            return cls(data, "<", 1, 0, 0)
        if len(data) < _ENCAPSULATION_BYTES:
            raise ValueError(_CUT_OFF)
        return cls(data, "<" if data[1] & 1 else ">", 4, _ENCAPSULATION_BYTES, _ENCAPSULATION_BYTES)

    @property
    def remaining(self) -> int:
        """Bytes that were not read yet; negative beyond the end."""
        return len(self.data) - self.place

    def numbers(self, codes: str) -> tuple[int, ...]:
        """Numbers that follow each other without gaps, by their codes of `struct`."""
        layout = _layout(self.order + codes)
        try:
            found = layout.unpack_from(self.data, self.place)
        except struct.error as error:
            raise ValueError(_CUT_OFF) from error
        self.place += layout.size
        return found

    def header(self) -> tuple[int, str]:
        """Stamp in nanoseconds and frame id of a ``std_msgs/Header``."""
        is_ros1 = self.alignment == 1
        if is_ros1:
            self.skip(_SEQUENCE_BYTES)
        seconds, nanoseconds = self.numbers("II" if is_ros1 else "iI")
        return seconds * 10**9 + nanoseconds, self.text().strip("/")

    def uint32(self) -> int:
        """An aligned number of four bytes."""
        self.align(4)
        return self.numbers("I")[0]

    def text(self) -> str:
        """A string."""
        return str(self.octets(), "utf-8", "replace").rstrip("\0")

    def octets(self) -> memoryview:
        """A sequence of bytes."""
        length = self.uint32()
        begin, self.place = self.place, self.place + length
        if self.place > len(self.data):
            raise ValueError(_CUT_OFF)
        return self.data[begin : self.place]

    def align(self, size: int) -> None:
        """Pass over what fills up to a number of so many bytes."""
        if self.alignment > 1:
            self.place += (self.start - self.place) % size

    def skip(self, size: int) -> None:
        """Pass over so many bytes."""
        self.place += size


def message_bytes(message: Message) -> memoryview:
    """The serialised message, unpacked where the bag has message compression.

    Raises:
        ValueError: it is lost, or cannot be unpacked; the text is a predicate.
    """
    if message.fault:
        raise ValueError(message.fault)
    # A bag with message compression says so in its metadata.yaml only; a serialised message never begins like this.
    if message.data[:4] != ZSTD_MAGIC:
        return memoryview(message.data)
    try:
        return unpack_zstd_message(message.data)
    except ValueError as error:
        raise ValueError(f"cannot be unpacked: {error}") from error
