# SPDX-License-Identifier: Apache-2.0
"""The views of a blueprint, one function per kind."""

from __future__ import annotations

from collections.abc import Sequence

import rerun.blueprint as rrb

from multilica.results import PairKey
from multilica.sinks.narration import pair_label
from multilica.sinks.rerun_camera import around_lidar
from multilica.sinks.rerun_tree import LOG, SUMMARY, lidar_frame, lidar_path, pair_path
from multilica.sinks.run_story import RunStory

__all__ = ["document_view", "log_view", "pair_view", "scene_view", "single_lidar_view", "summary_view"]

_DARK = (13, 16, 17)


def scene_view(
    name: str, frame: str, contents: Sequence[str], eye: rrb.EyeControls3D, *, grid: bool = False
) -> rrb.Spatial3DView:
    """Some entities as seen from a frame."""
    return rrb.Spatial3DView(
        origin="/",
        contents=list(contents),
        name=name,
        spatial_information=rrb.SpatialInformation(target_frame=frame),
        eye_controls=eye,
        line_grid=grid,
        background=_DARK,
    )


def single_lidar_view(story: RunStory, lidar: str, parts: Sequence[str]) -> rrb.Spatial3DView:
    """Some of one LiDAR's entities in its own frame."""
    contents = [f"{lidar_path(lidar, part)}/**" for part in ("sensor", *parts)]
    return scene_view(lidar, lidar_frame(lidar), contents, around_lidar(story, lidar))


def pair_view(
    story: RunStory, pair: PairKey, target_cloud: str, parts: Sequence[str], *, zoom: float = 1.0
) -> rrb.Spatial3DView:
    """The target's cloud with some of a pair's entities, in the target's frame."""
    target, source = pair
    contents = [
        lidar_path(target, target_cloud),
        lidar_path(target, "sensor"),
        *(f"{pair_path(target, source, part)}/**" for part in parts),
    ]
    return scene_view(pair_label(*pair), lidar_frame(target), contents, around_lidar(story, target, zoom=zoom))


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
