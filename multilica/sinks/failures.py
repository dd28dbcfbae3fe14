# SPDX-License-Identifier: Apache-2.0
"""Which LiDARs were not placed, at which stage, in which comparison."""

from __future__ import annotations

from dataclasses import dataclass

from multilica.config import Stage
from multilica.explanation import Comparison, Missing, explain
from multilica.results import PairKey
from multilica.sinks.run_document import run_document
from multilica.sinks.run_story import RunStory

__all__ = ["Failure", "decisive_failure", "failures"]


@dataclass(frozen=True, slots=True)
class Failure:
    """A LiDAR that was not placed.

    Args:
        stage: the last stage that it passed only in part, or not at all.
        pair: the comparison that came closest to placing it, as it was matched; None if there was none.
        elsewhere: the one that puts it at another place, where both were accepted; else None.
    """

    lidar: str
    stage: Stage
    pair: PairKey | None
    elsewhere: PairKey | None = None


def failures(story: RunStory) -> tuple[Failure, ...]:
    """Every LiDAR that was not placed; none if the run was refused, or stopped before it could place any."""
    document = run_document(story)
    if story.result is None or document is None:
        return ()
    return tuple(_failure(story, missing) for missing in explain(document).missing)


def decisive_failure(story: RunStory) -> Failure | None:
    """The one to look at first: the first that the explanation tells of which a registered pair can be seen.

    Where there is none, the first with matches, else the first of all.
    """
    return min(
        failures(story), key=lambda each: (each.pair not in story.registrations, each.pair is None), default=None
    )


def _failure(story: RunStory, missing: Missing) -> Failure:
    """The pair is the one that the explanation calls decisive, so that what is seen fits what is read beside it."""
    if missing.cause in ("dead_sensor", "no_returns_in_range"):
        return Failure(missing.lidar, "preprocess", None)
    if missing.decisive is not None:
        stage: Stage = "fine" if missing.decisive.codes else "merge"
        elsewhere = None if missing.elsewhere is None else _as_matched(story, missing.elsewhere)
        return Failure(missing.lidar, stage, _as_matched(story, missing.decisive), elsewhere)
    if not story.matches:
        return Failure(missing.lidar, "merge", None)
    own = [pair for pair in story.pairs if missing.lidar in pair]
    pair = max(own, key=lambda pair: _nearness(story, pair), default=None)
    return Failure(missing.lidar, "coarse" if pair is not None and _matched(story, pair) else "correspond", pair)


def _as_matched(story: RunStory, comparison: Comparison) -> PairKey | None:
    """None where the story knows nothing of the pair, as in a joint result."""
    sides = {comparison.target, comparison.source}
    return next((pair for pair in story.registrations if set(pair) == sides), None)


def _matched(story: RunStory, pair: PairKey) -> int:
    return len(story.matches.get(pair, ()))


def _nearness(story: RunStory, pair: PairKey | None) -> tuple[bool, float, int, PairKey]:
    """Orders pairs by how near they came to being merged."""
    if pair is None:
        return (False, 0.0, -1, ("", ""))
    found = story.registrations.get(pair)
    return (found is not None, found.evidence if found is not None else 0.0, _matched(story, pair), pair)
