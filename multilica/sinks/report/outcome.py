# SPDX-License-Identifier: Apache-2.0
"""Outcome of a run for the top of the report."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from multilica.diagnosis import Cause, Missing, Uncertain, explain
from multilica.results import PairKey
from multilica.sinks.report.contents import ReportContents


@dataclass(frozen=True, slots=True)
class UnplacedLidar:
    """A LiDAR that is not placed."""

    missing: Missing

    @property
    def pair(self) -> PairKey | None:
        """Return the decisive pair as it was registered."""
        decisive = self.missing.decisive
        return None if decisive is None else (decisive.target, decisive.source)

    @property
    def against(self) -> tuple[str, ...]:
        """Return the other LiDAR of the decisive pair, and the one that puts it elsewhere, if any."""
        elsewhere = self.missing.elsewhere
        names = (*(self.pair or ()), *((elsewhere.target, elsewhere.source) if elsewhere else ()))
        others = tuple(name for name in names if name != self.missing.lidar)
        return others if elsewhere else others[:1]


@dataclass(frozen=True, slots=True)
class Outcome:
    """The run in a few sentences.

    Args:
        badge: ``complete``, ``partial``, ``failed``, ``refused``, ``stopped`` or ``ended early``.
        known: findings of a run without a result.
        advice: for the whole run.
    """

    badge: str
    headline: str
    details: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    known: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    failures: tuple[UnplacedLidar, ...] = ()
    uncertain: tuple[Uncertain, ...] = ()


_BADGES: Mapping[Cause, str] = MappingProxyType({"unfinished": "ended early", "stopped_early": "stopped"})


def outcome_of(contents: ReportContents) -> Outcome:
    """Summarise the outcome."""
    document = contents.document
    explanation = explain(document)
    details: tuple[str, ...] = (contents.ended_early,) if contents.ended_early else ()
    if explanation.cause is not None:
        badge = _BADGES.get(explanation.cause, "refused")
        return Outcome(
            badge, explanation.headline, details, explanation.warnings, explanation.known, explanation.advice
        )
    if len(contents.poses()) > 1:
        details = (f"Target: {contents.target} ({document.target_reason.rstrip('.')}).", *details)
    badge = _BADGES["unfinished"] if contents.ended_early else document.status
    failures = tuple(UnplacedLidar(missing) for missing in explanation.missing)
    return Outcome(
        badge,
        explanation.headline,
        details,
        explanation.warnings,
        failures=failures,
        uncertain=explanation.uncertain,
    )
