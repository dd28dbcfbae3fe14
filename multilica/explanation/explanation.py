# SPDX-License-Identifier: Apache-2.0
"""What there is to say of a run."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

__all__ = ["Cause", "Comparison", "Explanation", "Missing", "Placed"]

Cause = Literal[
    "dead_sensor",
    "no_returns_in_range",
    "dirty_sensor",
    "moving_vehicle",
    "unfit_input",
    "no_overlap",
    "contradiction",
    "ambiguous",
    "not_observable",
    "unexplained",
    "low_fitness",
    "against_prior",
    "two_places",
    "not_in_rig",
    "not_joined",
    "disputed",
    "stopped_early",
    "unfinished",
    "unknown",
]
"""Why a LiDAR, or a whole run, came to no result; a stable name for programs."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """One pair of LiDARs at the best pose that was found for it.

    Args:
        target, source: names, as the pair was registered.
        codes: of the reasons against it, see `multilica.results.Reason`; none for an accepted pair.
        sentence: what spoke against it, or for it; the weightiest reason with its figures.
    """

    target: str
    source: str
    codes: tuple[str, ...]
    sentence: str


@dataclass(frozen=True, slots=True)
class Placed:
    """A LiDAR that was placed, the target left out.

    Args:
        sigma_m, sigma_deg: largest standard deviation over the axes; None where it is not known.
    """

    lidar: str
    sigma_m: float | None
    sigma_deg: float | None
    sentence: str


@dataclass(frozen=True, slots=True)
class Missing:
    """A LiDAR that was not placed.

    Args:
        headline: the LiDAR with its cause, in one sentence.
        step: the stage at which it was left out, with what failed there.
        decisive: the comparison that came closest to placing it; None where there was none.
        elsewhere: the one that puts it at another place, where both were accepted; else None.
        next_best: the best pose besides the decisive one, of the same pair or another; empty where there was none.
        by_snapshot: what each of several snapshots says of it, where no one comparison decides; else empty.
        advice: what would help, the most promising first.
    """

    lidar: str
    cause: Cause
    headline: str
    step: str
    decisive: Comparison | None = None
    elsewhere: Comparison | None = None
    next_best: str = ""
    by_snapshot: str = ""
    advice: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Explanation:
    """A run told to a technician.

    Args:
        headline: the outcome in one sentence, with the causes; the first thing to show.
        cause: of the whole run, where it was refused or cut off before any LiDAR could be placed; else None.
        input: what was calibrated, in one sentence.
        known: what a run that was refused or cut off had found by then.
        advice: what would help the whole run.
        warnings: what is doubtful although it did not stop the run.
    """

    headline: str
    input: str
    placed: tuple[Placed, ...] = ()
    missing: tuple[Missing, ...] = ()
    cause: Cause | None = None
    known: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def lines(self) -> tuple[str, ...]:
        """All of it as plain text, a sentence per line, what belongs to a line indented below it."""
        placed = (one.sentence for one in self.placed)
        return (self.headline, self.input, *placed, *self.known, *self._findings())

    @property
    def findings(self) -> tuple[str, ...]:
        """What a table of the placed LiDARs does not say: the headline, what is missing and what is doubtful."""
        return (self.headline, *self._findings())

    def _findings(self) -> Iterator[str]:
        for missing in self.missing:
            yield from _missing_lines(missing)
        for advice in self.advice:
            yield f"What helps: {advice}."
        for warning in self.warnings:
            yield f"Warning: {warning}"


def _missing_lines(missing: Missing) -> Iterator[str]:
    yield missing.headline
    yield f"  At stage {missing.step}."
    if missing.decisive is not None:
        yield f"  Decisive: {missing.decisive.sentence}"
    if missing.next_best:
        yield f"  Next best: {missing.next_best}"
    if missing.by_snapshot:
        yield f"  By snapshot: {missing.by_snapshot}"
    for advice in missing.advice:
        yield f"  What helps: {advice}."
