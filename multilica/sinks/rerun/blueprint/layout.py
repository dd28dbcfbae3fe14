# SPDX-License-Identifier: Apache-2.0
"""Blueprints of the viewer."""

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.encodings import EntityPathLike

from multilica.geometry import FloatArray
from multilica.results import CalibrationResult
from multilica.sinks.rerun.blueprint import views
from multilica.sinks.rerun.blueprint.camera import around_rig, three_quarter, up_axis
from multilica.sinks.rerun.blueprint.residual_tab import residual_tab
from multilica.sinks.rerun.blueprint.stage_tabs import stage_tab, stage_tabs
from multilica.sinks.rerun.entity_paths import CONFIG, GROUND, MERGE_STEPS, lidar_frame, lidar_path, pair_path
from multilica.sinks.rerun.input import name_pole_m
from multilica.sinks.rerun.scene import STEP_TIMELINE
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import pair_label
from multilica.sinks.unplaced import Failure, decisive_failure, failures

_RIG_MARGIN_M = 3.0
_RIG_NAME_SPACING_M = 0.5


def stage_blueprint(state: RunState) -> rrb.Blueprint:
    """Show the last finished stage, for a recording that ends there."""
    stage = state.stages[-1] if state.stages else "ingest"
    side = rrb.Vertical(views.summary_view(), views.log_view(), row_shares=[1, 1])
    return _blueprint(rrb.Horizontal(stage_tab(state, stage), side, column_shares=[2, 1]))


def final_blueprint(state: RunState) -> rrb.Blueprint:
    """Show the result, or the pair that failed, then a tab per stage."""
    stages = stage_tabs(state)
    last = rrb.Horizontal(
        views.log_view("All lines", ("DEBUG", "INFO", "WARN", "ERROR")),
        views.document_view(CONFIG, "Config"),
        name="Log",
    )
    first = [tab for tab in (_failure_tab(state), _result_tab(state), residual_tab(state)) if tab is not None]
    opened = 0 if first else len(stages) - 1
    return _blueprint(rrb.Tabs(*first, *stages, last, active_tab=opened))


def _blueprint(root: rrb.Container) -> rrb.Blueprint:
    time_panel = rrb.TimePanel(state="collapsed", timeline=STEP_TIMELINE, play_state="following")
    return rrb.Blueprint(
        root, time_panel, rrb.SelectionPanel(state="hidden"), rrb.BlueprintPanel(state="hidden"), auto_views=False
    )


def _failure_tab(state: RunState) -> rrb.Container | None:
    """Show the decisive pair at the stage where it failed, beside the reasons; None if there is nothing to show."""
    decisive = decisive_failure(state)
    if decisive is None or (decisive.pair is None and decisive.stage != "preprocess"):
        return None
    page = _page(decisive)
    side = rrb.Vertical(views.summary_view(), page, row_shares=[3, 2]) if page else views.summary_view()
    others = len(failures(state)) - 1
    name = f"Not placed: {decisive.lidar}{f' and {others} more' if others else ''}"
    return rrb.Horizontal(_failed_scene(state, decisive), side, column_shares=[3, 2], name=name)


def _failed_scene(state: RunState, failure: Failure) -> rrb.Container | rrb.View:
    """Show the pose with the most evidence above the competing one; without a pair the clouds of all LiDARs."""
    pair = failure.pair
    if pair is None:
        kept = {name: state.clouds[name].returns if name in state.clouds else 0 for name in state.lidars}
        names = {name: f"{name}: {count:,} returns kept" for name, count in kept.items()}
        shown = ("preprocessed", "dropped")
        return rrb.Grid(*(views.single_lidar_view(state, lidar, shown, name) for lidar, name in names.items()))
    if failure.stage in ("correspond", "coarse"):
        return views.matches_view(state, pair)
    if state.competing(pair) is None:
        return views.scored_view(state, pair)
    contents = [lidar_path(pair[0], "preprocessed"), f"{pair_path(*pair, 'competing')}/**"]
    competing = views.pair_view(state, pair, f"{pair_label(*pair)}, competing pose", contents, wide=True)
    return rrb.Vertical(views.scored_view(state, pair, wide=True), competing)


def _page(failure: Failure) -> rrb.View | None:
    if failure.stage == "merge":
        return views.document_view(MERGE_STEPS, "Merge steps")
    if failure.stage == "fine" and failure.pair is not None:
        return views.document_view(pair_path(*failure.pair, "scores"), "Scores")
    return None


def _result_tab(state: RunState) -> rrb.Container | None:
    """Show the merged cloud, the summary, and the rig with fields of view and uncertainty."""
    result = state.result
    if result is None or not state.target:
        return None
    posed = [place.lidar for place in result.placements if place.T_target_source is not None]
    clouds = [lidar_path(lidar, "preprocessed") for lidar in posed]
    sensors = [f"{lidar_path(lidar, part)}/**" for lidar in posed for part in ("sensor", "name")]
    extents = [lidar_path(lidar, part) for lidar in posed for part in ("field_of_view", "uncertainty")]
    frame = lidar_frame(result.target)
    eye = _rig_eye(result, up_axis(state, result.target))
    marks = [lidar_path(place.lidar, "uncertainty") for place in result.placements if place.uncertain]
    merged = views.scene_view("Merged cloud", frame, [*clouds, *sensors, *marks, GROUND], around_rig(state))
    rig = views.scene_view("Rig", frame, [*sensors, *extents], eye, grid=True, overrides=_short_names(state, result))
    side = rrb.Vertical(views.summary_view(), rig, row_shares=[1, 1])
    return rrb.Horizontal(merged, side, column_shares=[3, 2], name="Result")


def _short_names(state: RunState, result: CalibrationResult) -> dict[EntityPathLike, rr.Points3D | rr.LineStrips3D]:
    """Lower the names for a view of the rig alone."""
    lowered: dict[EntityPathLike, rr.Points3D | rr.LineStrips3D] = {}
    uncertain = {place.lidar for place in result.placements if place.uncertain}
    for index, lidar in enumerate(state.lidars):
        pole_m = name_pole_m(index, top=lidar in uncertain, spacing_m=_RIG_NAME_SPACING_M)
        lowered[lidar_path(lidar, "name")] = rr.LineStrips3D.from_fields(strips=pole_m)
        lowered[lidar_path(lidar, "name", "tip")] = rr.Points3D.from_fields(positions=pole_m[0, 1:])
    return lowered


def _rig_eye(result: CalibrationResult, up: FloatArray) -> rrb.EyeControls3D:
    poses = [place.T_target_source for place in result.placements]
    origins_m = np.array([pose.xyz_m for pose in poses if pose is not None])
    centre_m = origins_m.mean(axis=0)
    radius_m = _RIG_MARGIN_M + float(np.linalg.norm(origins_m - centre_m, axis=1).max())
    return three_quarter(centre_m, radius_m, up)
