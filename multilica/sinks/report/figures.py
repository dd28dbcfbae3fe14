# SPDX-License-Identifier: Apache-2.0
"""The pictures of a report."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import PairKey
from multilica.sinks.palette import AGREE, OCCLUDED, VIOLATE, Rgb, distinct_colours
from multilica.sinks.report.cloud_picture import Layer, View, draw_clouds, png_bytes, side_view, top_view
from multilica.sinks.report.contents import JudgedPoints, ReportContents
from multilica.stages.beam_image import BeamLabel

__all__ = ["Figure", "pair_figures", "rig_figures", "rig_picture"]

_SIZE_PX = (1080, 720)
_PAIR_SIZE_PX = (900, 640)
_JUDGED_DOT_PX = 4
_DIMMED = 0.6
_JUDGEMENTS: tuple[tuple[BeamLabel, Rgb], ...] = (
    (BeamLabel.OCCLUDED, OCCLUDED),
    (BeamLabel.AGREE, AGREE),
    (BeamLabel.VIOLATE, VIOLATE),
)


@dataclass(frozen=True, slots=True)
class Figure:
    """A picture with its words.

    Args:
        png: the file.
        alternative: what it shows, for those who do not see it.
        caption: what to look at.
    """

    png: bytes
    size_px: tuple[int, int]
    alternative: str
    caption: str

    @property
    def address(self) -> str:
        """The picture itself as a `data:` address."""
        return f"data:image/png;base64,{base64.b64encode(self.png).decode('ascii')}"


def rig_figures(contents: ReportContents, level: RigidTransform, colours: Mapping[str, Rgb]) -> dict[str, Figure]:
    """Top and side view of all clouds, each as recorded and as placed: `top_before`, `top_after`, `side_...`."""
    before = _rig_layers(contents, level, colours, placed=False)
    after = _rig_layers(contents, level, colours, placed=True)
    points_m = _all_points(after or before)
    views = {"top": top_view(points_m, _SIZE_PX), "side": side_view(points_m, _SIZE_PX[0])}
    axes = {"top": "Seen from above: x to the right, y up", "side": "Seen from the side: x to the right, z up"}
    words = {
        "before": ("as recorded", "Before: each cloud in its own LiDAR's frame, the frames laid on one another."),
        "after": ("as placed", "After: each cloud where its LiDAR was placed."),
    }
    figures = {}
    for side, view in views.items():
        for time, layers in (("before", before), ("after", after)):
            name, caption = words[time]
            shown = ", ".join(layer.label for layer in layers) or "no LiDAR"
            figures[f"{side}_{time}"] = _figure(
                view, layers, f"Point clouds {name}, {side} view: {shown}.", f"{caption} {axes[side]}."
            )
    return figures


def rig_picture(contents: ReportContents, level: RigidTransform, size_px: tuple[int, int]) -> bytes:
    """PNG of the calibrated clouds from above; as recorded where fewer than two LiDARs are placed."""
    placed = len(contents.placed_poses()) > 1
    layers = _rig_layers(contents, level, distinct_colours(contents.names), placed=placed)
    return png_bytes(draw_clouds(top_view(_all_points(layers), size_px), layers))


def _rig_layers(
    contents: ReportContents, level: RigidTransform, colours: Mapping[str, Rgb], *, placed: bool
) -> list[Layer]:
    """A layer per LiDAR with returns, in the level frame; as `placed`, those without a pose are left out."""
    same = {name: RigidTransform.identity(contents.target, name) for name in contents.names}
    poses = contents.placed_poses() if placed else same
    return [
        Layer(pose.apply(contents.clouds[name]), colours[name], sensor=pose, label=name)
        for name, pose in ((name, level @ pose) for name, pose in poses.items())
        if len(contents.clouds.get(name, ()))
    ]


def pair_figures(
    contents: ReportContents, pair: PairKey, level: RigidTransform, colours: Mapping[str, Rgb]
) -> list[Figure]:
    """A pair from above: the pose that was found, and the other one where two are as good."""
    words = ("at the best pose that was found", "at another pose that is about as good")
    if _accepted(contents, pair):
        words = ("where this pair puts it", "where another accepted pair puts it")
    shown = zip(contents.judged.get(pair, ()), words, strict=False)
    return [_pair_figure(contents, one, level, colours, how) for one, how in shown]


def _accepted(contents: ReportContents, pair: PairKey) -> bool:
    known = {(one["target"], one["source"]): one["verdict"]["outcome"] for one in contents.document["pairs"]}
    return known.get(pair) == "accept"


def _pair_figure(
    contents: ReportContents, judged: JudgedPoints, level: RigidTransform, colours: Mapping[str, Rgb], words: str
) -> Figure:
    """Both clouds, dimmed below the judged points of the source where there are any."""
    target, source = judged.T_target_source.target, judged.T_target_source.source
    T_level_target = _levelled(contents, judged.T_target_source, level)
    T_level_source = T_level_target @ judged.T_target_source
    counts = {label: int((judged.labels == label).sum()) for label, _ in _JUDGEMENTS}
    strength = _DIMMED if any(counts.values()) else 1.0
    layers = [
        Layer(pose.apply(contents.clouds[name]), colours[name], strength, 1, pose, name)
        for name, pose in ((target, T_level_target), (source, T_level_source))
    ]
    points_m = T_level_source.apply(judged.points_m)
    view = top_view(_all_points(layers), _PAIR_SIZE_PX, [T_level_target.xyz_m, T_level_source.xyz_m])
    layers += [Layer(points_m[judged.labels == label], colour, dot_px=_JUDGED_DOT_PX) for label, colour in _JUDGEMENTS]
    shown = f"{source} on {target} {words}, from above"
    if len(judged.points_m) == 0:
        return _figure(view, layers, f"{shown}.", f"{shown}, each in its colour.")
    if not any(counts.values()):
        unseen = f"{shown}: no point of one lies in view of the other, so nothing speaks against it."
        return _figure(view, layers, unseen, unseen)
    return _figure(
        view,
        layers,
        f"{shown}: {counts[BeamLabel.AGREE]} points agree, {counts[BeamLabel.VIOLATE]} stand in empty space, "
        f"{counts[BeamLabel.OCCLUDED]} are hidden.",
        f"{shown}; the large points are those of {source} that were judged.",
    )


def _levelled(contents: ReportContents, T_target_source: RigidTransform, level: RigidTransform) -> RigidTransform:
    """The pair's target in the level frame, over whichever of the two is placed; in its own axes if neither is."""
    placed, target = contents.placed_poses(), T_target_source.target
    if target in placed:
        return level @ placed[target]
    if T_target_source.source in placed:
        return level @ placed[T_target_source.source] @ T_target_source.inverse()
    return RigidTransform.identity(level.target, target)


def _all_points(layers: Sequence[Layer]) -> FloatArray:
    return np.concatenate([np.empty((0, 3)), *(layer.points_m for layer in layers)])


def _figure(view: View, layers: Sequence[Layer], alternative: str, caption: str) -> Figure:
    return Figure(png_bytes(draw_clouds(view, layers)), view.size_px, alternative, caption)
