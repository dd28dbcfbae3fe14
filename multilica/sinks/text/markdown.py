# SPDX-License-Identifier: Apache-2.0
"""Tables in markdown."""

import math
from collections.abc import Iterable, Sequence


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a table; cells may hold any text."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(escaped(cell) for cell in line)} |" for line in lines)


def thousandths(value: float) -> str:
    """Format with three decimals; a dash if not finite, as the RMSE without points in common."""
    return f"{value:.3f}" if math.isfinite(value) else "-"


def escaped(text: str) -> str:
    """Escape what would end a cell."""
    return text.replace("|", "\\|").replace("\n", " ")
