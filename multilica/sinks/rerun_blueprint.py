# SPDX-License-Identifier: Apache-2.0
"""What the viewer opens on."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import rerun.blueprint as rrb

from multilica.config import Stage
from multilica.geometry import FloatArray
from multilica.results import CalibrationResult, PairKey
from multilica.sinks.rerun_camera import above, around_rig, sampled_cloud, three_quarter, up_axis
from multilica.sinks.rerun_curves import CURVES
from multilica.sinks.rerun_input import shown_radius_m
from multilica.sinks.rerun_scene import STEP_TIMELINE
from multilica.sinks.rerun_tree import (
    CONFIG,
    DISPLAY_FRAME,
    FITNESS,
    GROUND,
    HYPOTHESES_TABLE,
    MERGE_CANDIDATES,
    MERGE_GRAPH,
    curve_path,
    lidar_frame,
    lidar_path,
)
from multilica.sinks.rerun_views import (
    document_view,
    log_view,
    pair_view,
    scene_view,
    single_lidar_view,
    summary_view,
)
from multilica.sinks.run_story import RunStory

__all__ = ["decisive_pair", "final_blueprint", "stage_blueprint"]

_MAX_PAIR_TABS = 15

Tab = rrb.Container | rrb.View


def stage_blueprint(story: RunStory) -> rrb.Blueprint:
    """While the run goes on: the last finished stage, for a recording that ends there."""
    stage = story.stages[-1] if story.stages else "ingest"
    page = _STAGE_TABS[stage](story) if stage in _STAGE_TABS else None
    main = page if page is not None else _input_tab(story)
    side = rrb.Vertical(summary_view(), log_view(), row_shares=[2, 3])
    return _blueprint(rrb.Horizontal(main, side, column_shares=[2, 1]))


def final_blueprint(story: RunStory) -> rrb.Blueprint:
    """The whole run: first the result, or the comparison that failed, then a tab per stage."""
    builders = dict.fromkeys(_STAGE_TABS.values())
    stages = [tab for build in builders if (tab := build(story)) is not None]
    last = rrb.Horizontal(log_view("All lines", ("DEBUG", "INFO", "WARN", "ERROR")), document_view(CONFIG, "Config"))
    first = [tab for tab in (_failure_tab(story), _result_tab(story)) if tab is not None]
    opened = 0 if first else len(stages) - 1
    return _blueprint(rrb.Tabs(*first, *stages, _named(last, "Log"), active_tab=opened))


def _blueprint(root: rrb.Container) -> rrb.Blueprint:
    time_panel = rrb.TimePanel(state="collapsed", timeline=STEP_TIMELINE, play_state="following")
    return rrb.Blueprint(
        root, time_panel, rrb.SelectionPanel(state="hidden"), rrb.BlueprintPanel(state="hidden"), auto_views=False
    )


def decisive_pair(story: RunStory) -> PairKey | None:
    """The comparison that decided against a LiDAR: the best that one took part in.

    None if all are placed, or if the run was stopped before it could place any.
    """
    if story.result is None or not story.decisions:
        return None
    missing = {place.lidar for place in story.result.placements if not place.placed}
    pairs = [pair for pair in story.pairs if missing & set(pair)]
    return max(pairs, key=lambda pair: (*_merit(story, pair), *pair), default=None)


def _merit(story: RunStory, pair: PairKey) -> tuple[bool, float, int]:
    """Orders pairs by how near they came to being merged."""
    found = story.registrations.get(pair)
    evidence = found.evidence if found is not None else 0.0
    return (found is not None, evidence, len(story.matches.get(pair, ())))


def _failure_tab(story: RunStory) -> Tab | None:
    pair = decisive_pair(story)
    if pair is None:
        return None
    if pair in story.coarse and not story.coarse[pair].hypotheses:
        scene = _matches_view(story, pair)
    else:
        scene = pair_view(story, pair, "preprocessed", ("source", "judged"))
    side = rrb.Vertical(summary_view(), log_view("Why", ("WARN", "ERROR")), row_shares=[3, 2])
    return _named(rrb.Horizontal(scene, side, column_shares=[3, 2]), "Not placed")


def _result_tab(story: RunStory) -> Tab | None:
    result = story.result
    if result is None or not story.target:
        return None
    placed = [place.lidar for place in result.placements if place.placed]
    clouds = [lidar_path(lidar, "preprocessed") for lidar in placed]
    sensors = [f"{lidar_path(lidar, part)}/**" for lidar in placed for part in ("sensor", "name")]
    frame = lidar_frame(result.target)
    merged = scene_view("Merged cloud", frame, [*clouds, *sensors, GROUND], around_rig(story))
    rig = scene_view("Rig", frame, sensors, _rig_eye(result, up_axis(story, result.target)), grid=True)
    side = rrb.Vertical(summary_view(), rig, log_view(), row_shares=[4, 3, 3])
    return _named(rrb.Horizontal(merged, side, column_shares=[3, 2]), "Result")


def _rig_eye(result: CalibrationResult, up: FloatArray) -> rrb.EyeControls3D:
    poses = [place.T_target_source for place in result.placements if place.placed]
    origins_m = np.array([pose.xyz_m for pose in poses if pose is not None])
    centre_m = origins_m.mean(axis=0)
    radius_m = 2.5 + float(np.linalg.norm(origins_m - centre_m, axis=1).max())
    return three_quarter(centre_m + up, radius_m, up)


def _input_tab(story: RunStory) -> rrb.Container:
    views = [single_lidar_view(story, lidar, ("raw",)) for lidar in story.lidars]
    return rrb.Grid(*views, name="Input")


def _preprocess_tab(story: RunStory) -> Tab | None:
    views = [single_lidar_view(story, lidar, ("preprocessed", "dropped")) for lidar in sorted(story.clouds)]
    return rrb.Grid(*views, name="Preprocess") if views else None


def _features_tab(story: RunStory) -> Tab | None:
    views = [single_lidar_view(story, lidar, ("features",)) for lidar in sorted(story.features)]
    return rrb.Grid(*views, name="Features") if views else None


def _shown_pairs(story: RunStory) -> list[PairKey]:
    """Those that a person can look through: the best where there are too many."""
    best = sorted(story.pairs, key=lambda pair: _merit(story, pair), reverse=True)
    return sorted(best[:_MAX_PAIR_TABS])


def _correspond_tab(story: RunStory) -> Tab | None:
    pairs = [pair for pair in _shown_pairs(story) if pair in story.matches]
    views = [_matches_view(story, pair) for pair in pairs]
    return rrb.Tabs(*views, name="Correspond") if views else None


def _matches_view(story: RunStory, pair: PairKey) -> rrb.Spatial3DView:
    """From far enough that both layers are seen."""
    return pair_view(story, pair, "features", ("matches",), zoom=0.6)


def _coarse_tab(story: RunStory) -> Tab | None:
    pairs = [pair for pair in _shown_pairs(story) if pair in story.coarse]
    if not pairs:
        return None
    views = [pair_view(story, pair, "preprocessed", ("source", "poses", "judged")) for pair in pairs]
    table = document_view(HYPOTHESES_TABLE, "Hypotheses")
    name = "Coarse + verify" if story.assessments else "Coarse"
    return _named(rrb.Horizontal(rrb.Tabs(*views), table, column_shares=[3, 2]), name)


def _fine_tab(story: RunStory) -> Tab | None:
    if not story.registrations:
        return None
    picture = rrb.Spatial2DView(origin=FITNESS, contents=["$origin/picture", "$origin/labels"], name="Fitness")
    table = document_view(f"{FITNESS}/table", "Fitness table")
    legend = rrb.PlotLegend(corner=rrb.Corner2D.RightTop)
    curves = [
        rrb.TimeSeriesView(origin=curve_path(quantity), name=title, plot_legend=legend)
        for quantity, title in CURVES.items()
    ]
    plots = rrb.Grid(*curves, grid_columns=2)
    return _named(rrb.Vertical(rrb.Horizontal(picture, table), plots), "Fine")


def _merge_tab(story: RunStory) -> Tab | None:
    if not story.decisions:
        return None
    graph = rrb.GraphView(origin=MERGE_GRAPH, name="Merge graph")
    contents = [
        f"{lidar_path(lidar, part)}/**" for lidar in story.lidars for part in ("preprocessed", "sensor", "name")
    ]
    growing = scene_view("Growing cloud", DISPLAY_FRAME, contents, above(*_display_box_m(story)))
    candidates = document_view(MERGE_CANDIDATES, "Candidates")
    side = rrb.Vertical(graph, candidates)
    return _named(rrb.Horizontal(growing, side, column_shares=[3, 2]), "Merge")


def _display_box_m(story: RunStory) -> tuple[FloatArray, FloatArray]:
    radii_m = [shown_radius_m(sampled_cloud(story, lidar)) for lidar in story.lidars]
    return np.array([-max(radii_m), -2.0 * sum(radii_m), 0.0]), np.array([max(radii_m), 0.0, 0.0])


def _named(container: rrb.Container, name: str) -> rrb.Container:
    container.name = name
    return container


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
