# SPDX-License-Identifier: Apache-2.0
"""First tab of a run that could not place a LiDAR."""

import rerun.blueprint as rrb

from multilica.results import PairKey
from multilica.sinks.failures import Failure, decisive_failure, failures
from multilica.sinks.rerun.blueprint.views import (
    competing_view,
    document_view,
    matches_view,
    scored_view,
    single_lidar_view,
    summary_view,
)
from multilica.sinks.rerun.tree import MERGE_STEPS, pair_path
from multilica.sinks.run_state import RunState

__all__ = ["failure_tab"]


def failure_tab(state: RunState) -> rrb.Container | None:
    """Show the decisive pair at the stage where it failed, beside the reasons; None if there is nothing to show."""
    decisive = decisive_failure(state)
    if decisive is None or (decisive.pair is None and decisive.stage != "preprocess"):
        return None
    page = _page(decisive)
    side = rrb.Vertical(summary_view(), page, row_shares=[3, 2]) if page else summary_view()
    others = len(failures(state)) - 1
    name = f"Not placed: {decisive.lidar}{f' and {others} more' if others else ''}"
    return rrb.Horizontal(_scene(state, decisive), side, column_shares=[3, 2], name=name)


def _scene(state: RunState, failure: Failure) -> rrb.Container | rrb.View:
    if failure.pair is None:
        return rrb.Grid(*(_seen_by(state, lidar) for lidar in state.lidars))
    if failure.stage in ("correspond", "coarse"):
        return matches_view(state, failure.pair)
    return _compared(state, failure.pair)


def _seen_by(state: RunState, lidar: str) -> rrb.View:
    """Show the cloud of one LiDAR beside the others: an empty one stands out."""
    kept = len(state.clouds[lidar].returns_m) if lidar in state.clouds else 0
    return single_lidar_view(state, lidar, ("preprocessed", "dropped"), f"{lidar}: {kept:,} returns kept")


def _compared(state: RunState, pair: PairKey) -> rrb.Container | rrb.View:
    """Show the pose with the most evidence; below it the competing pose, if there is one."""
    if state.competing(pair) is None:
        return scored_view(state, pair)
    return rrb.Vertical(scored_view(state, pair, wide=True), competing_view(state, pair, wide=True))


def _page(failure: Failure) -> rrb.View | None:
    if failure.stage == "merge":
        return document_view(MERGE_STEPS, "Merge steps")
    if failure.stage == "fine" and failure.pair is not None:
        return document_view(pair_path(*failure.pair, "scores"), "Scores")
    return None
