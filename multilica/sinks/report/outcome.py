# SPDX-License-Identifier: Apache-2.0
"""The first screen of a report: what came of the run."""

from __future__ import annotations

from dataclasses import dataclass

from multilica.config import STAGES
from multilica.explanation import Explanation, Missing, explain
from multilica.results import PairKey
from multilica.sinks.report.contents import ReportContents

__all__ = ["Failure", "Outcome", "outcome_of"]


@dataclass(frozen=True, slots=True)
class Failure:
    """A LiDAR that is not placed.

    Args:
        step: the stage at which it failed, with what failed there.
        pair: the comparison that came closest, as it was registered; None where there was none.
    """

    missing: Missing
    step: str
    pair: PairKey | None

    @property
    def against(self) -> str:
        """The other LiDAR of the decisive comparison; "" where there was none."""
        others = [name for name in self.pair or () if name != self.missing.lidar]
        return others[0] if others else ""


@dataclass(frozen=True, slots=True)
class Outcome:
    """The run in a few sentences.

    Args:
        badge: ``complete``, ``partial``, ``failed``, ``stopped`` as asked, or ``ended early``.
        details: what else there is to say at once.
    """

    badge: str
    headline: str
    details: tuple[str, ...]
    failures: tuple[Failure, ...] = ()


def outcome_of(contents: ReportContents) -> Outcome:
    """What the report says first."""
    document = contents.document
    if contents.ended_early:
        where = f" in stage {contents.ended_in}" if contents.ended_in else ""
        return Outcome("ended early", f"The run ended{where}, before it had a result.", (contents.ended_early,))
    until = document["config"]["until"]
    if STAGES.index(until) < STAGES.index("merge"):
        return Outcome("stopped", f"The run stopped after stage {until}, as asked; no LiDAR is placed yet.", ())
    explanation = explain(document)
    target = f"The target is {contents.target}: {document['target_reason'].rstrip('.')}."
    failures = tuple(_failure(contents, missing) for missing in explanation.missing)
    return Outcome(document["status"], _headline(contents, explanation), (target, *explanation.warnings), failures)


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


def _failure(contents: ReportContents, missing: Missing) -> Failure:
    if missing.decisive is None:
        returns = contents.document["input"]["lidars"][missing.lidar]["points"]
        step = "coarse: no pose was found with any other LiDAR" if returns else "preprocess: there were no returns"
        return Failure(missing, step, None)
    step = "fine: the verdict on the registered pair" if missing.decisive.codes else "merge: joining the groups"
    return Failure(missing, step, (missing.decisive.target, missing.decisive.source))
