# SPDX-License-Identifier: Apache-2.0
"""The first tab of a run that could not place a LiDAR."""

from __future__ import annotations

import rerun.blueprint as rrb

from multilica.results import PairKey
from multilica.sinks.failures import Failure, decisive_failure, failures
from multilica.sinks.rerun_tree import MERGE_CANDIDATES, pair_path
from multilica.sinks.rerun_views import (
    document_view,
    judged_view,
    matches_view,
    rival_view,
    single_lidar_view,
    summary_view,
)
from multilica.sinks.rival_pose import rival_of
from multilica.sinks.run_story import RunStory

__all__ = ["failure_tab"]


def failure_tab(story: RunStory) -> rrb.Container | None:
    """The decisive comparison at the stage where it failed, beside the reasons; None if there is nothing to see."""
    decisive = decisive_failure(story)
    if decisive is None or (decisive.pair is None and decisive.stage != "preprocess"):
        return None
    page = _page(decisive)
    side = rrb.Vertical(summary_view(), page, row_shares=[3, 2]) if page else summary_view()
    others = len(failures(story)) - 1
    name = f"Not placed: {decisive.lidar}{f' and {others} more' if others else ''}"
    return rrb.Horizontal(_scene(story, decisive), side, column_shares=[3, 2], name=name)


def _scene(story: RunStory, failure: Failure) -> rrb.Container | rrb.View:
    if failure.pair is None:
        return rrb.Grid(*(_seen_by(story, lidar) for lidar in story.lidars))
    if failure.stage in ("correspond", "coarse"):
        return matches_view(story, failure.pair)
    return _compared(story, failure.pair)


def _seen_by(story: RunStory, lidar: str) -> rrb.View:
    """What one LiDAR saw, among the others: one that saw nothing stands out."""
    kept = len(story.clouds[lidar].returns_m) if lidar in story.clouds else 0
    return single_lidar_view(story, lidar, ("preprocessed", "dropped"), f"{lidar}: {kept:,} returns kept")


def _compared(story: RunStory, pair: PairKey) -> rrb.Container | rrb.View:
    """The pose that is believed most; below it the other one, where the two cannot be told apart."""
    if rival_of(story, story.registrations[pair]) is None:
        return judged_view(story, pair)
    return rrb.Vertical(judged_view(story, pair, wide=True), rival_view(story, pair, wide=True))


def _page(failure: Failure) -> rrb.View | None:
    if failure.stage == "merge":
        return document_view(MERGE_CANDIDATES, "Candidates")
    if failure.stage == "fine" and failure.pair is not None:
        return document_view(pair_path(*failure.pair, "scores"), "Scores")
    return None
