# SPDX-License-Identifier: Apache-2.0
"""Tables in markdown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

__all__ = ["escaped", "markdown_table", "thousandths"]


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that may hold any text."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(escaped(cell) for cell in line)} |" for line in lines)


def thousandths(value: float) -> str:
    """With three decimals; a dash for what is not known: without points in common there is no RMSE."""
    return f"{value:.3f}" if math.isfinite(value) else "-"


def escaped(text: str) -> str:
    """Text that ends no cell."""
    return text.replace("|", "\\|").replace("\n", " ")
