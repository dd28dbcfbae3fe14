# SPDX-License-Identifier: Apache-2.0
"""The views of a blueprint, one function per kind."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import rerun as rr
import rerun.blueprint as rrb
from rerun.encodings import EntityPathLike

from multilica.results import PairKey
from multilica.sinks.narration import pair_label
from multilica.sinks.palette import distinct_colours
from multilica.sinks.rerun_camera import around_lidar, beside_lidar
from multilica.sinks.rerun_tree import LOG, SUMMARY, lidar_frame, lidar_path, pair_path
from multilica.sinks.run_story import RunStory

__all__ = [
    "before_view",
    "document_view",
    "judged_view",
    "log_view",
    "matches_view",
    "registered_view",
    "rival_view",
    "scene_view",
    "single_lidar_view",
    "summary_view",
]

_DARK = (13, 16, 17)
_DIM = 0.45
_JUDGED_LEGEND = ": green agrees, red stands in empty space, grey is hidden"


def scene_view(
    name: str,
    frame: str,
    contents: Sequence[str],
    eye: rrb.EyeControls3D,
    *,
    grid: bool = False,
    overrides: Mapping[EntityPathLike, rr.Points3D] | None = None,
) -> rrb.Spatial3DView:
    """Some entities as seen from a frame."""
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


def single_lidar_view(story: RunStory, lidar: str, parts: Sequence[str], name: str = "") -> rrb.Spatial3DView:
    """Some of one LiDAR's entities in its own frame."""
    contents = [f"{lidar_path(lidar, part)}/**" for part in ("sensor", *parts)]
    return scene_view(name or lidar, lidar_frame(lidar), contents, around_lidar(story, lidar))


def matches_view(story: RunStory, pair: PairKey) -> rrb.Spatial3DView:
    """The matches of a pair, from far enough that both layers are seen."""
    contents = [lidar_path(pair[0], "features"), f"{pair_path(*pair, 'matches')}/**"]
    return _pair_view(story, pair, pair_label(*pair), contents, zoom=0.6)


def judged_view(story: RunStory, pair: PairKey, *, wide: bool = False) -> rrb.Spatial3DView:
    """A pair at the pose that is shown at the step, its clouds dimmed below the points that the beams judged."""
    clouds = {lidar_path(pair[0], "preprocessed"): pair[0], pair_path(*pair, "source"): pair[1]}
    contents = [*clouds, f"{pair_path(*pair, 'judged')}/**", pair_path(*pair, "verdict"), pair_path(*pair, "slide")]
    name = f"{pair_label(*pair)}{_JUDGED_LEGEND if _is_judged(story, pair) else ''}"
    return _pair_view(story, pair, name, contents, wide=wide, overrides=_dimmed(story, clouds))


def _is_judged(story: RunStory, pair: PairKey) -> bool:
    found = story.registrations.get(pair)
    return bool(story.assessments.get(pair) or (found is not None and found.assessments))


def rival_view(story: RunStory, pair: PairKey, *, wide: bool = False) -> rrb.Spatial3DView:
    """A pair at the other pose that explains nearly as much."""
    contents = [lidar_path(pair[0], "preprocessed"), f"{pair_path(*pair, 'rival')}/**"]
    return _pair_view(story, pair, f"{pair_label(*pair)}, the other pose", contents, wide=wide)


def before_view(story: RunStory, pair: PairKey) -> rrb.Spatial3DView:
    """A pair where the coarse stage had put it."""
    contents = [lidar_path(pair[0], "preprocessed"), f"{pair_path(*pair, 'before')}/**"]
    return _pair_view(story, pair, "Before GICP", contents)


def registered_view(story: RunStory, pair: PairKey) -> rrb.Spatial3DView:
    """A pair at the pose that is shown at the step, at the last one the registered."""
    contents = [lidar_path(pair[0], "preprocessed"), pair_path(*pair, "source")]
    return _pair_view(story, pair, "After GICP", contents)


def _pair_view(
    story: RunStory,
    pair: PairKey,
    name: str,
    contents: Sequence[str],
    *,
    zoom: float = 1.0,
    wide: bool = False,
    overrides: Mapping[EntityPathLike, rr.Points3D] | None = None,
) -> rrb.Spatial3DView:
    """Entities of a pair in the target's frame; from aside in a view that is wider than high."""
    eye = beside_lidar(story, pair[0]) if wide else around_lidar(story, pair[0], zoom=zoom)
    sensor = lidar_path(pair[0], "sensor")
    return scene_view(name, lidar_frame(pair[0]), [sensor, *contents], eye, overrides=overrides)


def _dimmed(story: RunStory, clouds: Mapping[str, str]) -> dict[EntityPathLike, rr.Points3D]:
    """Per path of a cloud its LiDAR's colour, darker."""
    colours = distinct_colours(story.lidars)
    return {
        path: rr.Points3D.from_fields(
            colors=[tuple(int(_DIM * channel) for channel in colours[lidar])], radii=rr.Radius.ui_points(1.0)
        )
        for path, lidar in clouds.items()
    }


def log_view(name: str = "Log", levels: Sequence[str] = ("INFO", "WARN", "ERROR")) -> rrb.TextLogView:
    """The log without what only clutters it."""
    return rrb.TextLogView(
        origin=LOG,
        name=name,
        columns=rrb.TextLogColumns(timeline_columns=["step"], text_log_columns=["LogLevel", "Body"]),
        rows=rrb.TextLogRows(filter_by_log_level=list(levels)),
    )


def document_view(path: str, name: str) -> rrb.TextDocumentView:
    """A markdown document."""
    return rrb.TextDocumentView(origin=path, contents=[path], name=name)


def summary_view() -> rrb.TextDocumentView:
    """The summary of the run."""
    return document_view(SUMMARY, "Summary")
