# SPDX-License-Identifier: Apache-2.0
"""Changes that keep most of a file's structure: lengths, counts, offsets, types, nesting and texts."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable

import numpy as np

_WORD = re.compile(rb"[A-Za-z0-9_.+/-]{1,40}")
_NUMBERS = (0, 1, 2, 255, 256, 65535, 65536, 2**31 - 1, 2**31, 2**32 - 1, 2**40, 2**63 - 1, 2**63, 2**64 - 1)
_CODES = {1: "<B", 2: "<H", 4: "<I", 8: "<Q"}
_TEXTS = (
    b"", b"0", b"-1", b"1e999", b"-inf", b"nan", b"NaN", b"true", b"null", b"9" * 5000, b"1e300", b"0x" + b"f" * 600,
    b"[" * 3000, b"]" * 50, b'{"a":' * 3000, b"{a=" * 3000, b"a." * 3000 + b"a=1", b'"', b"'", b'"""', b"\\ud800",
    b"\\u202e", "\u202e".encode(), "\U0001f697".encode(), b"\xff\xfe", b"\x00", b"\x1b[31m", b"x" * 70_000, b"\n",
    b"\r", b"\t", b"#", b"%s%n", b"../../etc/passwd", b"2026-01-01T00:00:00Z", b"&a;", b"<!DOCTYPE a>", b"1 2 3", b",",
)  # fmt: skip
Strategy = Callable[[bytearray, np.random.Generator], None]


def structured(content: bytes, generator: np.random.Generator) -> bytes:
    """One to three changes of numbers that look like lengths or offsets, or of words."""
    changed = bytearray(content)
    for _ in range(int(generator.integers(1, 4))):
        strategy = _STRATEGIES[int(generator.integers(len(_STRATEGIES)))]
        strategy(changed, generator)
    return bytes(changed)


def _number(changed: bytearray, generator: np.random.Generator) -> None:
    """Change a number that is a plausible length, count, offset or opcode of this file."""
    for _ in range(50):
        width = int(generator.choice([1, 2, 4, 8]))
        if len(changed) < width:
            return
        place = int(generator.integers(len(changed) - width + 1))
        (value,) = struct.unpack_from(_CODES[width], changed, place)
        if width == 1 or 0 < value <= 2 * len(changed):
            near = (value - 1, value + 1, value * 2, value // 2, value ^ 0x80, len(changed) - place, len(changed))
            pool = near if generator.random() < 0.5 else _NUMBERS
            chosen = int(pool[int(generator.integers(len(pool)))])
            struct.pack_into(_CODES[width], changed, place, chosen % (1 << 8 * width))
            return


def _word(changed: bytearray, generator: np.random.Generator) -> None:
    """Replace a word by another kind of value."""
    start, end = _random_word(changed, generator)
    changed[start:end] = _TEXTS[int(generator.integers(len(_TEXTS)))]


def _digits(changed: bytearray, generator: np.random.Generator) -> None:
    """Replace a word by a number."""
    start, end = _random_word(changed, generator)
    value = int(_NUMBERS[int(generator.integers(len(_NUMBERS)))]) - int(generator.integers(2))
    changed[start:end] = str(value).encode()


def _swap(changed: bytearray, generator: np.random.Generator) -> None:
    """Put one word in the place of another: a name, a type or a value where it does not belong."""
    start, end = _random_word(changed, generator)
    word = bytes(changed[slice(*_random_word(changed, generator))])
    changed[start:end] = word[: end - start].ljust(end - start) if generator.random() < 0.5 else word


def _line(changed: bytearray, generator: np.random.Generator) -> None:
    """Drop, repeat or move a line."""
    lines = bytes(changed).split(b"\n")
    index, other = (int(generator.integers(len(lines))) for _ in range(2))
    kind = int(generator.integers(3))
    line = lines[index] if kind == 1 else lines.pop(index)
    if kind:
        lines[other:other] = [line] * (1 if kind == 2 else int(generator.integers(1, 20)))
    changed[:] = b"\n".join(lines)


def _block(changed: bytearray, generator: np.random.Generator) -> None:
    """Copy, drop or clear a long piece, as lost or repeated blocks of a disk."""
    size = max(1, len(changed))
    start, length = int(generator.integers(size)), int(generator.integers(1, max(2, size // 2)))
    kind = int(generator.integers(3))
    piece = bytes(changed[start : start + length])
    if kind == 0:
        changed[start : start + length] = bytes(len(piece))
    elif kind == 1:
        changed[start:start] = piece
    else:
        del changed[start : start + length]


def _random_word(changed: bytearray, generator: np.random.Generator) -> tuple[int, int]:
    """Find the next word behind a random place, often in the first part, where most formats have their texts."""
    reach = len(changed) if generator.random() < 0.5 else min(len(changed), 2000)
    found = _WORD.search(changed, int(generator.integers(max(1, reach))))
    return found.span() if found else (0, min(1, len(changed)))


_STRATEGIES: tuple[Strategy, ...] = (_number, _number, _number, _word, _word, _digits, _swap, _line, _block)
