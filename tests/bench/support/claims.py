# SPDX-License-Identifier: Apache-2.0
"""What is expected, beside what was measured."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from statistics import median


@dataclass(frozen=True, slots=True)
class Claim:
    """One line of the table that must be seen to hold."""

    measure: str
    expected: str
    measured: str
    holds: bool


def at_most(measure: str, values: Sequence[float], limit: float, unit: str) -> Claim:
    """The median of some repeats beside its limit."""
    measured = median(values)
    return Claim(measure, f"<= {limit:g} {unit}", f"{measured:.2f} {unit}", measured <= limit)


def print_claims(claims: Sequence[Claim]) -> bool:
    """Print them as a table; whether all hold."""
    print_table(
        ("measure", "expected", "measured", "holds"),
        [(each.measure, each.expected, each.measured, "yes" if each.holds else "no") for each in claims],
    )
    return all(each.holds for each in claims)


def print_table(header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print Markdown, with an empty line behind."""
    print(f"| {' | '.join(header)} |")
    print("|" + "---|" * len(header))
    for row in rows:
        print(f"| {' | '.join(str(cell).replace('|', '/') for cell in row)} |")
    print(flush=True)


def figure(value: float | None, digits: int) -> str:
    """The number with that many decimals; a dash for None."""
    return "-" if value is None else f"{value:.{digits}f}"
