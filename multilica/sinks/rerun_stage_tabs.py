# SPDX-License-Identifier: Apache-2.0
"""A tab per stage."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import rerun.blueprint as rrb

from multilica.config import Stage
from multilica.results import PairKey
from multilica.sinks.narration import pair_label
from multilica.sinks.rerun_camera import above_group
from multilica.sinks.rerun_curves import CURVES
from multilica.sinks.rerun_tree import (
    COVERAGE,
    DISPLAY_FRAME,
    DROPPED_TABLE,
    FITNESS,
    HYPOTHESES_TABLE,
    MERGE_CANDIDATES,
    MERGE_GRAPH,
    PAIRS_TABLE,
    VERDICTS,
    curve_path,
    lidar_path,
    pair_path,
)
from multilica.sinks.rerun_views import (
    before_view,
    document_view,
    judged_view,
    matches_view,
    registered_view,
    scene_view,
    single_lidar_view,
)
from multilica.sinks.run_story import RunStory

__all__ = ["stage_tab", "stage_tabs"]

_MAX_PAIR_TABS = 15

Tab = rrb.Container | rrb.View


def stage_tab(story: RunStory, stage: Stage) -> Tab:
    """That of one stage; the input where the stage has nothing to show."""
    tab = _STAGE_TABS[stage](story) if stage in _STAGE_TABS else None
    return tab if tab is not None else _input_tab(story)


def stage_tabs(story: RunStory) -> list[Tab]:
    """Those of all stages that have something to show, in order."""
    builders = dict.fromkeys(_STAGE_TABS.values())
    return [tab for build in builders if (tab := build(story)) is not None]


def _input_tab(story: RunStory) -> rrb.Container:
    views = [single_lidar_view(story, lidar, ("raw",)) for lidar in story.lidars]
    return rrb.Grid(*views, name="Input")


def _preprocess_tab(story: RunStory) -> Tab | None:
    views = [
        single_lidar_view(story, lidar, ("preprocessed", "dropped", "field_of_view")) for lidar in sorted(story.clouds)
    ]
    if not views:
        return None
    table = document_view(DROPPED_TABLE, "Dropped, and why")
    return rrb.Vertical(rrb.Grid(*views), table, row_shares=[3, 1], name="Preprocess")


def _features_tab(story: RunStory) -> Tab | None:
    views = [single_lidar_view(story, lidar, ("features",)) for lidar in sorted(story.features)]
    return rrb.Grid(*views, name="Features") if views else None


def _shown_pairs(story: RunStory) -> list[PairKey]:
    """Those that a person can look through: the best where there are too many."""
    best = sorted(story.pairs, key=lambda pair: _believed(story, pair), reverse=True)
    return sorted(best[:_MAX_PAIR_TABS])


def _believed(story: RunStory, pair: PairKey) -> tuple[bool, float, int]:
    found = story.registrations.get(pair)
    return (found is not None, found.evidence if found is not None else 0.0, len(story.matches.get(pair, ())))


def _correspond_tab(story: RunStory) -> Tab | None:
    pairs = [pair for pair in _shown_pairs(story) if pair in story.matches]
    views = [matches_view(story, pair) for pair in pairs]
    return rrb.Tabs(*views, name="Correspond") if views else None


def _coarse_tab(story: RunStory) -> Tab | None:
    pairs = [pair for pair in _shown_pairs(story) if pair in story.coarse]
    if not pairs:
        return None
    tabs = [
        rrb.Horizontal(
            judged_view(story, pair),
            document_view(pair_path(*pair, "scores"), "Scores"),
            column_shares=[3, 2],
            name=pair_label(*pair),
        )
        for pair in pairs
    ]
    table = document_view(HYPOTHESES_TABLE, "All pairs")
    return rrb.Tabs(*tabs, table, name="Coarse + verify" if story.assessments else "Coarse")


def _fine_tab(story: RunStory) -> Tab | None:
    if not story.registrations:
        return None
    matrices = [_matrix_view(path, name) for path, name in _MATRICES.items()]
    table = document_view(PAIRS_TABLE, "Pairs")
    figures = rrb.Vertical(rrb.Horizontal(*matrices), table, row_shares=[3, 2], name="Matrices")
    legend = rrb.PlotLegend(corner=rrb.Corner2D.RightTop)
    curves = [
        rrb.TimeSeriesView(origin=curve_path(quantity), name=title, plot_legend=legend)
        for quantity, title in CURVES.items()
    ]
    pairs = [pair for pair in _shown_pairs(story) if pair in story.registrations]
    moved = [
        rrb.Horizontal(before_view(story, pair), registered_view(story, pair), name=pair_label(*pair)) for pair in pairs
    ]
    return rrb.Tabs(
        figures, rrb.Grid(*curves, grid_columns=2, name="GICP"), rrb.Tabs(*moved, name="Before and after"), name="Fine"
    )


_MATRICES = {FITNESS: "Fitness", COVERAGE: "Coverage", VERDICTS: "Verdicts"}


def _matrix_view(path: str, name: str) -> rrb.View:
    return rrb.Spatial2DView(origin=path, contents=["$origin/picture", "$origin/labels"], name=name)


def _merge_tab(story: RunStory) -> Tab | None:
    if not story.decisions:
        return None
    graph = rrb.GraphView(origin=MERGE_GRAPH, name="Merge graph")
    contents = [
        f"{lidar_path(lidar, part)}/**" for lidar in story.lidars for part in ("preprocessed", "sensor", "name")
    ]
    growing = scene_view("Growing cloud", DISPLAY_FRAME, contents, above_group(story))
    side = rrb.Vertical(graph, document_view(MERGE_CANDIDATES, "Candidates"))
    return rrb.Horizontal(growing, side, column_shares=[3, 2], name="Merge")


_STAGE_TABS: Mapping[Stage, Callable[[RunStory], Tab | None]] = {
    "ingest": _input_tab,
    "preprocess": _preprocess_tab,
    "features": _features_tab,
    "correspond": _correspond_tab,
    "coarse": _coarse_tab,
    "verify": _coarse_tab,
    "fine": _fine_tab,
    "merge": _merge_tab,
}
