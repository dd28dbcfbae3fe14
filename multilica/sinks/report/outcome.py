# SPDX-License-Identifier: Apache-2.0
"""The first screen of a report: what came of the run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from multilica.explanation import Cause, Explanation, Missing, explain
from multilica.results import PairKey
from multilica.sinks.report.contents import ReportContents

__all__ = ["Failure", "Outcome", "outcome_of"]


@dataclass(frozen=True, slots=True)
class Failure:
    """A LiDAR that is not placed.

    Args:
        pair: the comparison that came closest, as it was registered; None where there was none.
    """

    missing: Missing
    pair: PairKey | None

    @property
    def against(self) -> tuple[str, ...]:
        """The other LiDAR of the decisive comparison, and the one that puts it elsewhere; none where there was none."""
        elsewhere = self.missing.elsewhere
        names = (*(self.pair or ()), *((elsewhere.target, elsewhere.source) if elsewhere else ()))
        others = tuple(name for name in names if name != self.missing.lidar)
        return others if elsewhere else others[:1]


@dataclass(frozen=True, slots=True)
class Outcome:
    """The run in a few sentences.

    Args:
        badge: ``complete``, ``partial``, ``failed``, ``refused``, ``stopped`` as asked, or ``ended early``.
        details: what else there is to say at once.
        warnings: what is doubtful although it did not stop the run.
        known: what a run without a result had found.
        advice: what would help the whole run.
    """

    badge: str
    headline: str
    details: tuple[str, ...]
    warnings: tuple[str, ...] = ()
    known: tuple[str, ...] = ()
    advice: tuple[str, ...] = ()
    failures: tuple[Failure, ...] = ()


_BADGES: Mapping[Cause, str] = MappingProxyType({"unfinished": "ended early", "stopped_early": "stopped"})


def outcome_of(contents: ReportContents) -> Outcome:
    """What the report says first."""
    document = contents.document
    explanation = explain(document)
    ended_early = (contents.ended_early,) if contents.ended_early else ()
    if explanation.cause is not None:
        badge = _BADGES.get(explanation.cause, "refused")
        return Outcome(
            badge, explanation.headline, ended_early, explanation.warnings, explanation.known, explanation.advice
        )
    failures = tuple(_failure(missing) for missing in explanation.missing)
    headline = _headline(contents, explanation)
    badge = _BADGES["unfinished"] if ended_early else document["status"]
    return Outcome(badge, headline, (*_target(contents), *ended_early), explanation.warnings, failures=failures)


def _target(contents: ReportContents) -> tuple[str, ...]:
    """Why that one; not where nothing was placed relative to it."""
    if len(contents.placed_poses()) < 2:
        return ()
    return (f"The target is {contents.target}: {contents.document['target_reason'].rstrip('.')}.",)


def _headline(contents: ReportContents, explanation: Explanation) -> str:
    missing = [one.lidar for one in explanation.missing]
    count = len(contents.names)
    if not missing:
        return f"All {count} LiDARs are placed."
    if len(missing) == count - 1:
        return f"No LiDAR is placed relative to {contents.target}."
    return f"{count - len(missing)} of {count} LiDARs are placed; {' and '.join(missing)} {_is(missing)} not."


def _is(names: list[str]) -> str:
    return "is" if len(names) == 1 else "are"


def _failure(missing: Missing) -> Failure:
    decisive = missing.decisive
    return Failure(missing, None if decisive is None else (decisive.target, decisive.source))
