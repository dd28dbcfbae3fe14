# SPDX-License-Identifier: Apache-2.0
"""Types of an explanation."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

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
    "uncertain",
    "unexplained",
    "low_fitness",
    "against_prior",
    "two_places",
    "not_in_rig",
    "not_joined",
    "disputed",
    "stopped_early",
    "out_of_time",
    "unfinished",
    "unknown",
]
"""Cause why a LiDAR or a whole run has no result, or a doubtful one; a stable name for programs."""


@dataclass(frozen=True, slots=True)
class DecisivePair:
    """The registered pair that decided whether a LiDAR is placed.

    Args:
        codes: of the reasons against it, see `multilica.results.Reason`; none for an accepted pair.
        sentence: the most important reason with its figures.
    """

    target: str
    source: str
    codes: tuple[str, ...]
    sentence: str


@dataclass(frozen=True, slots=True)
class Placed:
    """A placed LiDAR other than the target; each sigma is the largest over the axes, None without a covariance."""

    lidar: str
    sigma_m: float | None
    sigma_deg: float | None
    sentence: str


@dataclass(frozen=True, slots=True)
class Missing:
    """A LiDAR that was not placed.

    Args:
        headline: the LiDAR with its cause, in one sentence.
        step: the stage at which it was left out, with the failure.
        decisive: the pair that was nearest to placing it; None without pairs.
        elsewhere: the accepted pair that puts it at another place; None unless two accepted pairs contradict.
        next_best: the next pose of the decisive pair, or the next pair; empty if there is none.
        by_snapshot: reason per snapshot, if no single pair decides; else empty.
        advice: what would help, the most promising first.
    """

    lidar: str
    cause: Cause
    headline: str
    step: str
    decisive: DecisivePair | None = None
    elsewhere: DecisivePair | None = None
    next_best: str = ""
    by_snapshot: str = ""
    advice: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Uncertain:
    """A LiDAR with one pose, uncontradicted, whose standard deviation is above the limit.

    Args:
        headline: the LiDAR with its figure, direction and limit, in one sentence.
        direction: the one that exceeds its limit, such as "mostly along x of top".
        sigma_m, sigma_deg: standard deviations of position and rotation in their weakest directions.
        max_sigma_m, max_sigma_deg: the limits.
        advice: what would help, the most promising first.
    """

    lidar: str
    headline: str
    direction: str
    sigma_m: float
    sigma_deg: float
    max_sigma_m: float
    max_sigma_deg: float
    advice: tuple[str, ...]
    cause: Cause = "uncertain"


@dataclass(frozen=True, slots=True)
class Explanation:
    """The outcome of a run for people.

    Args:
        headline: the outcome in one sentence, with the causes; the first thing to show.
        cause: of the whole run, if it was refused or cut off before any LiDAR could be placed; else None.
        input: what was calibrated, in one sentence.
        known: what a refused or cut off run had found by then.
        advice: what would help the whole run.
        warnings: doubts that did not stop the run.
    """

    headline: str
    input: str
    placed: tuple[Placed, ...] = ()
    missing: tuple[Missing, ...] = ()
    uncertain: tuple[Uncertain, ...] = ()
    cause: Cause | None = None
    known: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()

    @property
    def lines(self) -> tuple[str, ...]:
        """The facts beside the table of placed LiDARs as plain text, a sentence per line, details indented."""
        return (self.headline, self.input, *self.known, *self._findings())

    @property
    def findings(self) -> tuple[str, ...]:
        """The same for a run whose input is known: headline, missing and uncertain LiDARs, warnings."""
        return (self.headline, *self._findings())

    def _findings(self) -> Iterator[str]:
        for missing in self.missing:
            yield from _missing_lines(missing)
        for uncertain in self.uncertain:
            yield uncertain.headline
            yield from _advice_lines(uncertain.advice)
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
    yield from _advice_lines(missing.advice)


def _advice_lines(advice: Iterable[str]) -> Iterator[str]:
    for each in advice:
        yield f"  What helps: {each}."
