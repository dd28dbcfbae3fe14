# SPDX-License-Identifier: Apache-2.0
"""Views of a blueprint."""

from collections.abc import Mapping, Sequence

import rerun as rr
import rerun.blueprint as rrb
from rerun.encodings import EntityPathLike

from multilica.results import PairKey
from multilica.sinks.drawing.palette import distinct_colours
from multilica.sinks.drawing.shapes import kept_count
from multilica.sinks.rerun.blueprint.camera import around_lidar, beside_lidar
from multilica.sinks.rerun.entity_paths import LOG, SUMMARY, lidar_frame, lidar_path, pair_path
from multilica.sinks.rerun.matches import lift_m
from multilica.sinks.run_state import RunState
from multilica.sinks.text.log_lines import pair_label

_DARK = (13, 16, 17)
_DIM = 0.45
_SCORED_LEGEND = ": green agrees, red lies in proven-empty space, grey is occluded"


def scene_view(
    name: str,
    frame: str,
    contents: Sequence[str],
    eye: rrb.EyeControls3D,
    *,
    grid: bool = False,
    overrides: Mapping[EntityPathLike, rr.Points3D | rr.LineStrips3D] | None = None,
) -> rrb.Spatial3DView:
    """Show entities in a frame."""
    return rrb.Spatial3DView(
        origin="/",
        contents=list(contents),
        name=name,
        spatial_information=rrb.SpatialInformation(target_frame=frame),
        eye_controls=eye,
        line_grid=grid,
        overrides=overrides,
        background=_DARK,
    )


def single_lidar_view(state: RunState, lidar: str, parts: Sequence[str], name: str = "") -> rrb.Spatial3DView:
    """Show entities of one LiDAR in its own frame."""
    contents = [f"{lidar_path(lidar, part)}/**" for part in ("sensor", *parts)]
    return scene_view(name or lidar, lidar_frame(lidar), contents, around_lidar(state, lidar))


def matches_view(state: RunState, pair: PairKey, *, kept_only: bool = False) -> rrb.Spatial3DView:
    """Show the matches of a pair, or only those kept, from far enough to see both layers."""
    contents = [lidar_path(pair[0], "features"), f"{pair_path(*pair, 'matches')}/**"]
    hidden = [f"- {pair_path(*pair, 'matches', 'rejected')}"] if kept_only else []
    name = _matches_legend(state, pair, kept_only=kept_only)
    raised_m = lift_m(state.matches[pair]) / 2.0 if state.matches.get(pair) else 0.0
    return pair_view(state, pair, name, [*contents, *hidden], zoom=0.6, raised_m=raised_m)


def _matches_legend(state: RunState, pair: PairKey, *, kept_only: bool) -> str:
    """Count the matches that the best hypothesis keeps and rejects, with their colours."""
    total, kept = len(state.matches.get(pair, ())), kept_count(state, pair)
    if pair not in state.coarse:
        return f"{pair_label(*pair)}: {total:,} matches (grey)"
    if kept_only:
        return f"{pair_label(*pair)}: {kept:,} of {total:,} matches kept (green)"
    return f"{pair_label(*pair)}: {kept:,} kept (green), {total - kept:,} rejected (red)"


def scored_view(state: RunState, pair: PairKey, *, wide: bool = False) -> rrb.Spatial3DView:
    """Show a pair at the pose of the step, its clouds dimmed below the scored points."""
    clouds = {lidar_path(pair[0], "preprocessed"): pair[0], pair_path(*pair, "source"): pair[1]}
    contents = [*clouds, f"{pair_path(*pair, 'scored')}/**", pair_path(*pair, "verdict"), pair_path(*pair, "slide")]
    colours, found = distinct_colours(state.lidars), state.registrations.get(pair)
    dimmed = {path: [int(_DIM * channel) for channel in colours[lidar]] for path, lidar in clouds.items()}
    overrides: dict[EntityPathLike, rr.Points3D | rr.LineStrips3D] = {
        path: rr.Points3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(1.0))
        for path, colour in dimmed.items()
    }
    is_scored = state.verified.get(pair) or (found is not None and found.registrations)
    name = f"{pair_label(*pair)}{_SCORED_LEGEND if is_scored else ''}"
    return pair_view(state, pair, name, contents, wide=wide, overrides=overrides)


def pair_view(
    state: RunState,
    pair: PairKey,
    name: str,
    contents: Sequence[str],
    *,
    zoom: float = 1.0,
    raised_m: float = 0.0,
    wide: bool = False,
    overrides: Mapping[EntityPathLike, rr.Points3D | rr.LineStrips3D] | None = None,
) -> rrb.Spatial3DView:
    """Show entities of a pair in the target's frame; from the side in a `wide` view."""
    eye = beside_lidar(state, pair[0]) if wide else around_lidar(state, pair[0], zoom=zoom, raised_m=raised_m)
    sensor = lidar_path(pair[0], "sensor")
    return scene_view(name, lidar_frame(pair[0]), [sensor, *contents], eye, overrides=overrides)


def log_view(name: str = "Log", levels: Sequence[str] = ("INFO", "WARN", "ERROR")) -> rrb.TextLogView:
    """Show the log lines of some levels."""
    return rrb.TextLogView(
        origin=LOG,
        name=name,
        columns=rrb.TextLogColumns(timeline_columns=["step"], text_log_columns=["LogLevel", "Body"]),
        rows=rrb.TextLogRows(filter_by_log_level=list(levels)),
    )


def document_view(path: str, name: str) -> rrb.TextDocumentView:
    """Show a markdown document."""
    return rrb.TextDocumentView(origin=path, contents=[path], name=name)


def summary_view() -> rrb.TextDocumentView:
    """Show the summary of the run."""
    return document_view(SUMMARY, "Summary")
