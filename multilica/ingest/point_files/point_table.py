# SPDX-License-Identifier: Apache-2.0
"""Tables of points, as text or records."""

from dataclasses import dataclass
from itertools import islice

import numpy as np

from multilica.geometry import Float32Array
from multilica.pointcloud2 import PointCloud2, PointField, decode_points, finite_points, point_dtype

__all__ = ["PointTable", "Points"]

Points = tuple[Float32Array, Float32Array | None]
"""Finite points (N, 3), intensities (N,)."""


@dataclass(frozen=True, slots=True)
class PointTable:
    """The layout of a table, with `fields` in the order of its columns.

    Its methods raise ValueError, with a predicate as its text, if the data are broken.
    """

    fields: tuple[PointField, ...] = ()
    rows: int = 0
    row_bytes: int = 0

    def needed(self) -> tuple[str, ...]:
        """Return the names of the fields to read."""
        return point_dtype(self.fields, self.row_bytes, big_endian=False).names or ()

    def read_text(self, body: bytes, skip: int = 0) -> Points:
        """Read the rows after the first `skip`; empty lines do not count."""
        columns: dict[str, int] = {}
        width = 0
        for field in self.fields:
            columns.setdefault(field.name, width)
            width += field.count
        chosen = [columns[name] for name in self.needed()]
        filled = (line for line in body.splitlines() if line.strip())
        lines = list(islice(filled, skip, skip + self.rows))
        if len(lines) < self.rows:
            raise ValueError(f"ends after {len(lines)} of its {self.rows} points")
        try:
            table = np.loadtxt(lines, np.float64, comments=None, usecols=chosen, ndmin=2, encoding="latin1")
        except ValueError as error:
            reason = str(error).partition(";")[0].rstrip(".")
            raise ValueError(f"has text that is not a table of points: {reason}") from error
        return finite_points(*table.T)

    def read_records(self, body: memoryview, *, big_endian: bool = False) -> Points:
        """Read rows of `row_bytes` each."""
        if self.rows * self.row_bytes > len(body):
            raise ValueError(f"ends after {len(body) // self.row_bytes} of its {self.rows} points")
        return decode_points(PointCloud2(self.fields, self.rows, 1, self.row_bytes, 0, body, big_endian))
