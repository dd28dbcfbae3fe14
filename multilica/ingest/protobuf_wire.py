# SPDX-License-Identifier: Apache-2.0
"""Protocol buffers, field by field."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import TypeAlias

__all__ = ["Field", "fields_of", "fixed32", "float64"]

Field: TypeAlias = tuple[int, int | memoryview]
"""Number of a field with its value: an integer, or the bytes of what is fixed in size or tells its own length."""

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_MAX_VARINT_BYTES = 10


def fields_of(message: memoryview) -> Iterator[Field]:
    """Each field in the order of writing; nothing is copied.

    Raises:
        ValueError: the bytes are no such message; the text is a predicate.
    """
    place = 0
    while place < len(message):
        key, place = _varint(message, place)
        kind = key & 7
        if kind == _VARINT:
            value, place = _varint(message, place)
            yield key >> 3, value
            continue
        size = {_FIXED64: 8, _FIXED32: 4}.get(kind)
        if kind == _BYTES:
            size, place = _varint(message, place)
        if size is None or size > len(message) - place:
            raise ValueError("cannot be unpacked: it is no protocol buffer, or was cut off")
        yield key >> 3, message[place : place + size]
        place += size


def fixed32(value: int | memoryview) -> int:
    """An unsigned number of four bytes."""
    return int(_fixed("<I", value))


def float64(value: int | memoryview) -> float:
    """A number of eight bytes."""
    return float(_fixed("<d", value))


def _fixed(layout: str, value: int | memoryview) -> int | float:
    if isinstance(value, int) or len(value) != struct.calcsize(layout):
        raise ValueError("cannot be unpacked: a field of the protocol buffer is not of its type")
    number: int | float = struct.unpack(layout, value)[0]
    return number


def _varint(message: memoryview, place: int) -> tuple[int, int]:
    value = 0
    for index, byte in enumerate(message[place : place + _MAX_VARINT_BYTES]):
        value |= (byte & 0x7F) << (7 * index)
        if byte < 0x80:
            return value, place + index + 1
    raise ValueError("cannot be unpacked: it is no protocol buffer, or was cut off")
