# SPDX-License-Identifier: Apache-2.0
"""Pictures of a report."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import LEVEL_FRAME, BeamLabel, PairKey
from multilica.sinks.drawing.palette import AGREE, OCCLUDED, VIOLATE, Rgb
from multilica.sinks.drawing.shapes import every_nth
from multilica.sinks.report.cloud_picture import (
    Layer,
    View,
    draw_clouds,
    fitted_height_px,
    is_upright,
    png_bytes,
    side_view,
    top_view,
)
from multilica.sinks.report.contents import ReportContents, ScoredPoints
from multilica.sinks.report.rig_scene import FIRST_VIEW_RAD

_WIDTH_PX = 1280
_HEIGHT_SHARES = (0.4, 0.625)
"""Least and most height of a view from above, as shares of the width."""
_OBLIQUE_SIZE_PX = (1000, 562)
_PAIR_SIZE_PX = (1200, 800)
_RIG_DOT_PX = 2
_SCORED_DOT_PX = 5
_RIG_POINTS = 400_000
"""More change little that can be seen."""
QUARTER_TURN = RigidTransform.from_xyz_rpy("view", LEVEL_FRAME, (0.0, 0.0, 0.0), (0.0, 0.0, np.pi / 2.0))
"""From x to the right, y up to x up, y to the left."""
_DIMMED = 0.6
_SAME_POSE = 1e-4
"""Metres and radians: a recording holds poses in single precision."""
_LABEL_COLOURS: tuple[tuple[BeamLabel, Rgb], ...] = (
    (BeamLabel.OCCLUDED, OCCLUDED),
    (BeamLabel.AGREE, AGREE),
    (BeamLabel.VIOLATE, VIOLATE),
)


@dataclass(frozen=True, slots=True)
class Figure:
    """A PNG picture with its alternative text and caption."""

    png: bytes
    size_px: tuple[int, int]
    alternative: str
    caption: str

    @property
    def address(self) -> str:
        """Return the picture as a `data:` URL."""
        return f"data:image/png;base64,{base64.b64encode(self.png).decode('ascii')}"


def rig_figures(
    contents: ReportContents, level: RigidTransform, colours: Mapping[str, Rgb], *, calibrated: bool
) -> dict[str, Figure]:
    """Draw all clouds before and, if calibrated, after: `top_before`, `top_after`, `side_...`, and `oblique`."""
    before = _rig_layers(contents, level, colours, placed=False)
    after = _rig_layers(contents, level, colours, placed=True) if calibrated else before
    figures = {"oblique": _oblique_figure(after, "as placed" if calibrated else "as recorded")}
    axes = {"top": "Seen from above: x to the right, y up", "side": "Seen from the right: x to the right, z up"}
    if is_upright(_all_points(after)):
        before, after = ([layer.moved(QUARTER_TURN) for layer in layers] for layers in (before, after))
        axes = {"top": "Seen from above: x up, y to the left", "side": "Seen from behind: y to the left, z up"}
    points_m = _all_points(after)
    size_px = (_WIDTH_PX, fitted_height_px(points_m, _WIDTH_PX, *_HEIGHT_SHARES))
    views = {"top": top_view(points_m, size_px), "side": side_view(points_m, _WIDTH_PX)}
    lead = "Before: " if calibrated else "As recorded: "
    words = {
        "before": ("as recorded", f"{lead}each cloud in the frame of its own LiDAR, all frames at the origin."),
        "after": ("as placed", "After: each cloud at the pose of its LiDAR."),
    }
    for side, view in views.items():
        for time, layers in (("before", before), ("after", after))[: 1 + calibrated]:
            name, caption = words[time]
            alternative = f"Point clouds {name}, {side} view: {_labels(layers)}."
            figures[f"{side}_{time}"] = _figure(view, layers, alternative, f"{caption} {axes[side]}.")
    return figures


def _oblique_figure(layers: Sequence[Layer], name: str) -> Figure:
    """Draw the clouds as the 3-D view first shows them, for paper and for browsers that cannot draw it."""
    yaw, pitch = FIRST_VIEW_RAD
    right = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    back = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
    axes = np.stack([right, np.cross(back, right), back])
    moved = [
        layer.moved(RigidTransform.from_rotation_translation("view", LEVEL_FRAME, axes, np.zeros(3)))
        for layer in layers
    ]
    view = top_view(_all_points(moved), _OBLIQUE_SIZE_PX)
    return _figure(view, moved, f"Point clouds {name}, seen at an angle from above: {_labels(layers)}.", "")


def _labels(layers: Sequence[Layer]) -> str:
    return ", ".join(layer.label for layer in layers) or "no LiDAR"


def _rig_layers(
    contents: ReportContents, level: RigidTransform, colours: Mapping[str, Rgb], *, placed: bool
) -> list[Layer]:
    """Return a layer per LiDAR with returns, in the level frame; if `placed`, without unplaced LiDARs."""
    same = {name: RigidTransform.identity(contents.target, name) for name in contents.names}
    poses = contents.poses if placed else same
    enough = _RIG_POINTS // max(1, len(poses))
    return [
        Layer(
            pose.apply(every_nth(contents.clouds[name], enough)),
            colours[name],
            dot_px=_RIG_DOT_PX,
            sensor=pose,
            label=f"{name} (uncertain)" if placed and contents.is_uncertain(name) else name,
        )
        for name, pose in ((name, level @ pose) for name, pose in poses.items())
        if len(contents.clouds.get(name, ()))
    ]


def pair_figures(
    contents: ReportContents, pair: PairKey, level: RigidTransform, colours: Mapping[str, Rgb]
) -> list[Figure]:
    """Draw a pair from above: the best pose, then the competing one, if any."""
    scored = contents.scored.get(pair, ())
    words = ("at the best pose", _competing_words(contents, pair, scored))
    if any(one.key == pair and one.verdict.accepted for one in contents.document.pairs):
        words = ("at the pose of this pair", "at the pose that another accepted pair implies")
    return [_pair_figure(contents, one, level, colours, how) for one, how in zip(scored, words, strict=False)]


def _competing_words(contents: ReportContents, pair: PairKey, scored: Sequence[ScoredPoints]) -> str:
    """Name the second pose: the next best that the pair's own search found, or one that follows from other pairs."""
    entry = next((one for one in contents.document.pairs if one.key == pair), None)
    own = (
        [] if entry is None else [RigidTransform(*pair, np.asarray(one.T_target_source)) for one in entry.registrations]
    )
    if any(max(pose.distance_to(one.T_target_source)) < _SAME_POSE for one in scored[1:] for pose in own):
        return "at the next best pose"
    return "at a competing pose that other pairs imply"


def _pair_figure(
    contents: ReportContents, scored: ScoredPoints, level: RigidTransform, colours: Mapping[str, Rgb], words: str
) -> Figure:
    """Draw both clouds, dimmed below their scored points."""
    target, source = scored.T_target_source.target, scored.T_target_source.source
    T_level_target = _levelled(contents, scored.T_target_source, level)
    T_level_source = T_level_target @ scored.T_target_source
    points_m = np.concatenate([T_level_source.apply(scored.points_m), T_level_target.apply(scored.target_points_m)])
    labels = np.concatenate([scored.labels, scored.target_labels])
    is_scored = bool(np.isin(labels, [label for label, _ in _LABEL_COLOURS]).any())
    layers = [
        Layer(pose.apply(contents.clouds[name]), colours[name], _DIMMED if is_scored else 1.0, _RIG_DOT_PX, pose, name)
        for name, pose in ((target, T_level_target), (source, T_level_source))
    ]
    view = top_view(_all_points(layers), _PAIR_SIZE_PX, [T_level_target.xyz_m, T_level_source.xyz_m])
    layers += [Layer(points_m[labels == label], colour, dot_px=_SCORED_DOT_PX) for label, colour in _LABEL_COLOURS]
    shown = f"{source} on {target} {words}, from above"
    if len(points_m) == 0:
        return _figure(view, layers, f"{shown}.", f"{shown}, each in its colour.")
    if not is_scored:
        unseen = f"{shown}: neither LiDAR sees a point of the other, so nothing contradicts this pose."
        return _figure(view, layers, unseen, unseen)
    counts = (
        f"{scored.agree:,} points agree, {scored.violate:,} lie in proven-empty space, {scored.occluded:,} are occluded"
    )
    text = f"{shown}: {counts}. The evidence is {scored.evidence:z.1f}."
    return _figure(view, layers, text, f"{text} Large points are those of both LiDARs, scored by visibility.")


def _levelled(contents: ReportContents, T_target_source: RigidTransform, level: RigidTransform) -> RigidTransform:
    """Return the pose of the pair's target in the level frame; its own axes if neither LiDAR is placed."""
    placed, target = contents.poses, T_target_source.target
    if target in placed:
        return level @ placed[target]
    if T_target_source.source in placed:
        return level @ placed[T_target_source.source] @ T_target_source.inverse()
    return RigidTransform.identity(level.target, target)


def _all_points(layers: Sequence[Layer]) -> FloatArray:
    return np.concatenate([np.empty((0, 3)), *(layer.points_m for layer in layers)])


def _figure(view: View, layers: Sequence[Layer], alternative: str, caption: str) -> Figure:
    return Figure(png_bytes(draw_clouds(view, layers)), view.size_px, alternative, caption)
