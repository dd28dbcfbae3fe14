# SPDX-License-Identifier: Apache-2.0
"""Blueprints of the viewer."""

from collections.abc import Callable, Container, Mapping, Sequence

import numpy as np
import rerun.blueprint as rrb

from multilica.config import Stage
from multilica.geometry import RigidTransform
from multilica.results import PairKey
from multilica.sinks.drawing import ellipsoid_label, ellipsoid_scale, kept_count, slot_offsets_m
from multilica.sinks.rerun import scene
from multilica.sinks.rerun.lidars import RESIDUAL_SCALE_M
from multilica.sinks.rerun.names import names_apart
from multilica.sinks.rerun.pairs import starting_hypothesis
from multilica.sinks.rerun.tables import candidate_pairs, matrix_bounds
from multilica.sinks.rerun.views import (
    Overrides,
    above_drive,
    above_group,
    around_lidar,
    around_rig,
    beside_lidar,
    document_view,
    log_view,
    matches_view,
    pair_view,
    scene_view,
    scored_view,
    single_lidar_view,
    three_quarter,
    up_axis,
)
from multilica.sinks.run_state import Failure, RunState, decisive_failure, failures
from multilica.sinks.text.log_lines import pair_label

_MAX_PAIR_TABS = 15
_Tab = rrb.Container | rrb.View
_MATRICES = {scene.FITNESS: "Fitness", scene.COVERAGE: "Coverage", scene.VERDICTS: "Verdicts"}
_RIG_MARGIN_M = 3.0
_MERGED_VIEW_PX, _RIG_VIEW_PX = (760.0, 590.0), (500.0, 280.0)
"""Sizes of views in a window of 1280 x 720 pixels."""


def _residual_tab(state: RunState) -> rrb.Container | None:
    """Show where the merged clouds meet, and where they do not; None where no two LiDARs are joined."""
    document = state.document
    if document.status == "unfinished" or len(document.lidars) < 2 or not state.residuals:
        return None
    contents = [
        path
        for lidar in sorted(state.residuals)
        for path in (scene.lidar_path(lidar, "residual"), f"{scene.lidar_path(lidar, 'name')}/**")
    ]
    name = f"Distance to the other LiDARs' surfaces: dark 0 m, bright {RESIDUAL_SCALE_M:g} m or more"
    eye = around_rig(state)
    names = _names(state, document.poses, eye, _MERGED_VIEW_PX)
    view = scene_view(name, scene.lidar_frame(document.target), contents, eye, overrides=names)
    return rrb.Horizontal(view, name="Residual")


def _movable_tab(state: RunState) -> rrb.Container | None:
    """Show the objects that moved and are left out, or that could have and hold a pose; None without such objects."""
    document = state.document
    if state.left_out:
        objects = "Objects that moved (orange) are left out"
    elif any(entry.held_by_movable for entry in document.lidars.values()):
        objects = "Objects that could have moved (orange) hold a pose"
    else:
        return None
    contents = [scene.lidar_path(lidar, kind) for lidar in sorted(document.lidars) for kind in ("residual", "movable")]
    name = f"{objects}; other points by their distance to other LiDARs' surfaces"
    view = scene_view(name, scene.lidar_frame(document.target), contents, around_rig(state))
    return rrb.Horizontal(view, name="Movable")


def _drive_tab(state: RunState) -> _Tab | None:
    """Show the stops of a drive from above, a view per group of stops that links connect; None without linked stops."""
    document = state.document
    if document.status == "unfinished":
        return None
    firsts = dict.fromkeys(stop.first for stop in document.stops)
    legend = ": links are green if used, else grey; the timeline stop shows one stop at a time"
    views = [
        scene_view(
            f"Stops linked with {first}{legend}",
            scene.lidar_frame(document.target),
            [f"{scene.drive_path(first)}/**"],
            above_drive(state, first),
        )
        for first in firsts
    ]
    return rrb.Grid(*views, name="Drive") if views else None


def stage_tab(state: RunState, stage: Stage) -> _Tab:
    """Return the tab of one stage, or of the input if the stage has nothing to show."""
    tab = _STAGE_TABS[stage](state) if stage in _STAGE_TABS else None
    return tab if tab is not None else _input_tab(state)


def _input_tab(state: RunState) -> rrb.Container:
    views = [single_lidar_view(state, lidar, ("raw",)) for lidar in state.lidars]
    return rrb.Grid(*views, name="Input")


def _preprocess_tab(state: RunState) -> _Tab | None:
    views = [
        single_lidar_view(state, lidar, ("preprocessed", "dropped", "field_of_view")) for lidar in sorted(state.clouds)
    ]
    if not views:
        return None
    table = document_view(scene.DROPPED_TABLE, "Dropped points")
    return rrb.Vertical(rrb.Grid(*views), table, row_shares=[3, 1], name="Preprocess")


def _features_tab(state: RunState) -> _Tab | None:
    views = [single_lidar_view(state, lidar, ("features",)) for lidar in sorted(state.features)]
    return rrb.Grid(*views, name="Features") if views else None


def _shown_pairs(state: RunState) -> list[PairKey]:
    """Return the decisive pairs and those with the most evidence, at most as many as a person can look through."""
    decisive = {failure.pair for failure in failures(state)}
    ranked = sorted(state.pairs, key=lambda pair: (pair in decisive, state.progress_of(pair)), reverse=True)
    return sorted(ranked[:_MAX_PAIR_TABS])


def _opened(state: RunState, pairs: Sequence[PairKey]) -> int:
    """Return the index of the decisive pair of a LiDAR that is not placed, else of the weakest pair in use."""
    decisive = decisive_failure(state)
    failed = [failure.pair for failure in (decisive, *failures(state)) if failure is not None]
    verdicts = {pair: state.registrations[pair].verdict for pair in pairs if pair in state.registrations}
    used = [pair for pair, verdict in verdicts.items() if verdict.counts]
    used.sort(key=lambda pair: (verdicts[pair].outcome == "accept", state.registrations[pair].evidence))
    return next((pairs.index(pair) for pair in (*failed, *used) if pair in pairs), 0)


def _pair_tabs(
    state: RunState, known: Container[PairKey], tab: Callable[[RunState, PairKey], _Tab], name: str, *more: _Tab
) -> _Tab | None:
    """Return a tab per shown pair that is known, then more tabs; None without such a pair."""
    pairs = [pair for pair in _shown_pairs(state) if pair in known]
    tabs = (tab(state, pair) for pair in pairs)
    return rrb.Tabs(*tabs, *more, active_tab=_opened(state, pairs), name=name) if pairs else None


def _matches_tab(state: RunState, pair: PairKey) -> rrb.Container:
    """Show the matches that the best hypothesis agrees with; the rejected ones are a tab further."""
    shown = (True, False) if kept_count(state, pair) else (False,)
    return rrb.Tabs(*(matches_view(state, pair, kept_only=kept) for kept in shown), name=pair_label(*pair))


def _coarse_tab(state: RunState) -> _Tab | None:
    table = document_view(scene.HYPOTHESES_TABLE, "All pairs")
    return _pair_tabs(state, state.coarse, _scores_tab, "Coarse + verify" if state.verified else "Coarse", table)


def _scores_tab(state: RunState, pair: PairKey) -> rrb.Container:
    scores = document_view(scene.pair_path(*pair, "scores"), "Scores")
    return rrb.Horizontal(scored_view(state, pair), scores, column_shares=[3, 2], name=pair_label(*pair))


def _fine_tab(state: RunState) -> _Tab | None:
    if not state.registrations:
        return None
    (left, top), (right, bottom) = matrix_bounds(len(state.lidars))
    bounds = rrb.VisualBounds2D(x_range=[left, right], y_range=[top, bottom])
    contents = ["$origin/picture", "$origin/labels"]
    matrices = [
        rrb.Spatial2DView(origin=path, contents=contents, name=name, visual_bounds=bounds)
        for path, name in _MATRICES.items()
    ]
    table = document_view(scene.PAIRS_TABLE, "Pairs")
    figures = rrb.Vertical(rrb.Tabs(*matrices), table, row_shares=[1, 1], name="Matrices")
    legend = rrb.PlotLegend(corner=rrb.Corner2D.RightTop)
    curves = [
        rrb.TimeSeriesView(origin=scene.curve_path(quantity), name=title, plot_legend=legend)
        for quantity, title in scene.CURVES.items()
    ]
    moved = _pair_tabs(state, state.registrations, _before_and_after, "Before and after")
    gicp = rrb.Grid(*curves, grid_columns=2, name="GICP")
    return rrb.Tabs(*(tab for tab in (figures, gicp, moved) if tab is not None), name="Fine")


def _before_and_after(state: RunState, pair: PairKey) -> rrb.Container:
    """Show a pair at the hypothesis from which GICP started, and at the pose of the step, last the registered one.

    A pair that started from the pose that others imply has no hypothesis.
    """
    clouds = [scene.lidar_path(pair[0], "preprocessed"), scene.pair_path(*pair, "source")]
    eye = around_lidar(state, pair[0])
    if starting_hypothesis(state, pair, state.registrations[pair]) is None:
        after = pair_view(pair, "After GICP, which started from the implied pose", clouds, eye)
        return rrb.Horizontal(after, name=pair_label(*pair))
    before = pair_view(pair, "Before GICP", [clouds[0], f"{scene.pair_path(*pair, 'before')}/**"], eye)
    return rrb.Horizontal(before, pair_view(pair, "After GICP", clouds, eye), name=pair_label(*pair))


def _merge_tab(state: RunState) -> _Tab | None:
    if not state.decisions:
        return None
    graph = rrb.GraphView(origin=scene.MERGE_GRAPH, name="Merge graph")
    contents = [
        f"{scene.lidar_path(lidar, part)}/**" for lidar in state.lidars for part in ("preprocessed", "sensor", "name")
    ]
    eye = above_group(state)
    names = _names(state, _poses_in_slots(state), eye, _MERGED_VIEW_PX)
    growing = scene_view("Growing cloud", scene.DISPLAY_FRAME, contents, eye, overrides=names)
    pairs = [pair for pair in _shown_pairs(state) if pair in candidate_pairs(state)]
    evidence = rrb.TimeSeriesView(
        origin=scene.PAIRS,
        contents=[scene.pair_path(*pair, "merge", "evidence") for pair in pairs],
        name="Evidence of the candidates per merge step",
        plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.RightTop),
    )
    steps = rrb.Tabs(document_view(scene.MERGE_STEPS, "Merge steps"), evidence)
    side = rrb.Vertical(graph, steps)
    return rrb.Horizontal(growing, side, column_shares=[3, 2], name="Merge")


def _names(
    state: RunState, poses: Mapping[str, RigidTransform], eye: rrb.EyeControls3D, size_px: tuple[float, float]
) -> Overrides:
    scale = ellipsoid_scale(state.document)
    labels = {lidar: ellipsoid_label(state.document, lidar, scale) or lidar for lidar in poses}
    return names_apart(labels, poses, eye, size_px)


def _poses_in_slots(state: RunState) -> dict[str, RigidTransform]:
    """Return where LiDARs are shown after the last merge step: with the target, or in slots of their own."""
    poses = state.document.poses
    offsets_m = slot_offsets_m(state)
    slots = {
        lidar: RigidTransform.from_xyz_rpy(scene.DISPLAY_FRAME, lidar, (0.0, offset_m, 0.0), (0.0, 0.0, 0.0))
        for lidar, offset_m in offsets_m.items()
    }
    joined = {lidar: slots[state.target] @ pose for lidar, pose in poses.items() if state.target in slots}
    return slots | joined


_STAGE_TABS: Mapping[Stage, Callable[[RunState], _Tab | None]] = {
    "ingest": _input_tab,
    "preprocess": _preprocess_tab,
    "features": _features_tab,
    "correspond": lambda state: _pair_tabs(state, state.matches, _matches_tab, "Correspond"),
    "coarse": _coarse_tab,
    "verify": _coarse_tab,
    "fine": _fine_tab,
    "merge": _merge_tab,
}


def stage_blueprint(state: RunState) -> rrb.Blueprint:
    """Show the last finished stage, for a recording that ends there."""
    stage = state.stages[-1] if state.stages else "ingest"
    side = rrb.Vertical(document_view(scene.SUMMARY, "Summary"), log_view(), row_shares=[1, 1])
    return _blueprint(rrb.Horizontal(stage_tab(state, stage), side, column_shares=[2, 1]))


def final_blueprint(state: RunState) -> rrb.Blueprint:
    """Show the result, or the pair that failed, then a tab per stage."""
    stages = [tab for build in dict.fromkeys(_STAGE_TABS.values()) if (tab := build(state)) is not None]
    lines = log_view("All lines", ("DEBUG", "INFO", "WARN", "ERROR"))
    last = rrb.Horizontal(lines, document_view(scene.CONFIG, "Config"), name="Log")
    builders = (_failure_tab, _result_tab, _drive_tab, _movable_tab, _residual_tab)
    first = [tab for build in builders if (tab := build(state)) is not None]
    opened = 0 if first else len(stages) - 1
    return _blueprint(rrb.Tabs(*first, *stages, last, active_tab=opened))


def _blueprint(root: rrb.Container) -> rrb.Blueprint:
    time_panel = rrb.TimePanel(state="collapsed", timeline=scene.STEP_TIMELINE, play_state="following")
    return rrb.Blueprint(
        root, time_panel, rrb.SelectionPanel(state="hidden"), rrb.BlueprintPanel(state="hidden"), auto_views=False
    )


def _failure_tab(state: RunState) -> rrb.Container | None:
    """Show the decisive pair at the stage where it failed, beside the reasons; None if there is nothing to show."""
    decisive = decisive_failure(state)
    if decisive is None or (decisive.pair is None and decisive.stage != "preprocess"):
        return None
    side: _Tab = document_view(scene.SUMMARY, "Summary")
    if decisive.stage == "merge":
        side = rrb.Vertical(side, document_view(scene.MERGE_STEPS, "Merge steps"), row_shares=[3, 2])
    elif decisive.stage == "fine" and decisive.pair is not None:
        scores = document_view(scene.pair_path(*decisive.pair, "scores"), "Scores")
        side = rrb.Vertical(side, scores, row_shares=[3, 2])
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
        return rrb.Grid(*(single_lidar_view(state, lidar, shown, name) for lidar, name in names.items()))
    if failure.stage in ("correspond", "coarse"):
        return matches_view(state, pair)
    if state.competing(pair) is None:
        return scored_view(state, pair)
    contents = [scene.lidar_path(pair[0], "preprocessed"), f"{scene.pair_path(*pair, 'competing')}/**"]
    competing = pair_view(
        pair, f"{pair_label(*pair)}, competing pose: green agrees there as well", contents, beside_lidar(state, pair[0])
    )
    return rrb.Vertical(scored_view(state, pair, wide=True), competing)


def _result_tab(state: RunState) -> rrb.Container | None:
    """Show the merged cloud, the summary, and the rig with fields of view and uncertainty."""
    document = state.document
    if document.status == "unfinished" or not state.target:
        return None
    poses = document.poses
    clouds = [scene.lidar_path(lidar, "preprocessed") for lidar in poses]
    sensors = [f"{scene.lidar_path(lidar, part)}/**" for lidar in poses for part in ("sensor", "name")]
    extents = [scene.lidar_path(lidar, part) for lidar in poses for part in ("field_of_view", "uncertainty")]
    uncertain = [lidar for lidar, entry in document.lidars.items() if entry.status == "uncertain"]
    frame, marks = scene.lidar_frame(document.target), [scene.lidar_path(lidar, "uncertainty") for lidar in uncertain]
    around = around_rig(state)
    names = _names(state, poses, around, _MERGED_VIEW_PX)
    merged = scene_view("Merged cloud", frame, [*clouds, *sensors, *marks, scene.GROUND], around, overrides=names)
    origins_m = np.array([pose.xyz_m for pose in poses.values()])
    centre_m = np.mean(origins_m, axis=0)
    radius_m = _RIG_MARGIN_M + float(np.linalg.norm(origins_m - centre_m, axis=1).max())
    eye = three_quarter(centre_m, radius_m, up_axis(state, document.target))
    names = _names(state, poses, eye, _RIG_VIEW_PX)
    rig = scene_view("Rig", frame, [*sensors, *extents], eye, grid=True, overrides=names)
    side = rrb.Vertical(document_view(scene.SUMMARY, "Summary"), rig, row_shares=[1, 1])
    return rrb.Horizontal(merged, side, column_shares=[3, 2], name="Result")
