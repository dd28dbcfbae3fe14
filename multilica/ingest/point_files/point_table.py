# SPDX-License-Identifier: Apache-2.0
"""Tables of points, as text or records."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from itertools import islice

import numpy as np

from multilica.geometry import Float32Array
from multilica.pointcloud2 import PointCloud2, PointField, decode_points, finite_points, point_dtype

Points = tuple[Float32Array, Float32Array | None]
"""Finite points (N, 3), intensities (N,)."""


MAX_HEADER_BYTES = 1 << 16
MAX_LINE_BYTES = 1 << 16
_MAX_DIGITS = 18
_MAX_REASON = 200


def row_count(word: str) -> int:
    """Return a whole number of a header; raise ValueError for anything else."""
    if not (word.isascii() and word.isdigit() and len(word) <= _MAX_DIGITS):
        raise ValueError("expected a whole number")
    return int(word)


@dataclass(frozen=True, slots=True)
class PointTable:
    """The layout of a table, with `fields` in the order of its columns.

    Its methods raise ValueError, with a predicate as its text, if the data are broken.
    """

    fields: tuple[PointField, ...] = ()
    rows: int = 0
    row_bytes: int = 0

    def claimed_bytes(self, *, is_text: bool) -> int:
        """Return the largest size of the rows in bytes."""
        return self.rows * (MAX_LINE_BYTES if is_text else self.row_bytes)

    def needed(self) -> tuple[str, ...]:
        """Return the names of the fields to read."""
        return point_dtype(self.fields, self.row_bytes, big_endian=False).names or ()

    def read_text(self, body: memoryview, skip: int = 0) -> Points:
        """Read the rows after the first `skip`; empty lines do not count."""
        columns: dict[str, int] = {}
        width = 0
        for field in self.fields:
            columns.setdefault(field.name, width)
            width += field.count
        chosen = [columns[name] for name in self.needed()]
        lines = islice(_filled_lines(body), skip, skip + self.rows)
        try:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="loadtxt: input contained no data")
                table = np.loadtxt(lines, np.float64, comments=None, usecols=chosen, ndmin=2, encoding="latin1")
        except ValueError as error:
            reason = str(error).partition(";")[0].rstrip(".")[:_MAX_REASON]
            raise ValueError(f"has text that is not a table of points: {reason}") from error
        if len(table) < self.rows:
            raise ValueError(f"ends after {len(table)} of its {self.rows} points")
        return finite_points(*table.T)

    def read_records(self, body: memoryview, *, big_endian: bool = False) -> Points:
        """Read rows of `row_bytes` each."""
        if self.rows * self.row_bytes > len(body):
            raise ValueError(f"ends after {len(body) // self.row_bytes} of its {self.rows} points")
        return decode_points(PointCloud2(self.fields, self.rows, 1, self.row_bytes, 0, body, big_endian))


def _filled_lines(body: memoryview) -> Iterator[bytes]:
    """Yield the lines that are not empty; they may end as on an old Mac."""
    has_lines = b"\n" in bytes(body[:MAX_LINE_BYTES])
    text = BytesIO(body if has_lines else bytes(body).replace(b"\r", b"\n"))
    while line := text.readline(MAX_LINE_BYTES):
        if len(line) == MAX_LINE_BYTES:
            raise ValueError(f"a line has more than {MAX_LINE_BYTES} bytes")
        if line.strip():
            yield line
