# SPDX-License-Identifier: Apache-2.0
"""Columns of numbers in text."""

from collections.abc import Sequence
from itertools import islice

import numpy as np

from multilica.geometry import FloatArray

__all__ = ["read_columns"]


def read_columns(body: bytes, columns: Sequence[int], rows: int, skip: int = 0) -> list[FloatArray]:
    """Return columns (rows,) of the rows after the first `skip`; empty lines do not count.

    Raises:
        ValueError: there are fewer rows or columns, or no numbers; the text is a predicate.
    """
    filled = (line for line in body.splitlines() if line.strip())
    lines = list(islice(filled, skip, skip + rows))
    if len(lines) < rows:
        raise ValueError(f"ends after {len(lines)} of its {rows} points")
    try:
        table = np.loadtxt(lines, np.float64, comments=None, usecols=columns, ndmin=2, encoding="latin1")
    except ValueError as error:
        reason = str(error).partition(";")[0].rstrip(".")
        raise ValueError(f"has text that is not a table of points: {reason}") from error
    return list(table.T)
