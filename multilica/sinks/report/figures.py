# SPDX-License-Identifier: Apache-2.0
"""Pictures of a report."""

import base64
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import BeamLabel, PairKey
from multilica.sinks.drawing.clouds import every_nth
from multilica.sinks.drawing.palette import AGREE, OCCLUDED, VIOLATE, Rgb
from multilica.sinks.report.cloud_picture import Layer, View, draw_clouds, png_bytes, side_view, top_view
from multilica.sinks.report.contents import ReportContents, ScoredPoints

__all__ = ["Figure", "pair_figures", "rig_figures"]

_SIZE_PX = (1080, 720)
_PAIR_SIZE_PX = (900, 640)
_SCORED_DOT_PX = 4
# One per two pixels: more change little that can be seen.
_RIG_POINTS = _SIZE_PX[0] * _SIZE_PX[1] // 2
_DIMMED = 0.6
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
    """Draw top and side views of all clouds before and, if calibrated, after: `top_before`, `top_after`, `side_...`."""
    before = _rig_layers(contents, level, colours, placed=False)
    after = _rig_layers(contents, level, colours, placed=True)
    points_m = _all_points(after or before)
    views = {"top": top_view(points_m, _SIZE_PX), "side": side_view(points_m, _SIZE_PX[0])}
    axes = {"top": "Seen from above: x to the right, y up", "side": "Seen from the side: x to the right, z up"}
    words = {
        "before": ("as recorded", "Before: each cloud in the frame of its own LiDAR, all frames at the origin."),
        "after": ("as placed", "After: each cloud at the pose of its LiDAR."),
    }
    figures = {}
    for side, view in views.items():
        for time, layers in (("before", before), ("after", after))[: 1 + calibrated]:
            name, caption = words[time]
            shown = ", ".join(layer.label for layer in layers) or "no LiDAR"
            figures[f"{side}_{time}"] = _figure(
                view, layers, f"Point clouds {name}, {side} view: {shown}.", f"{caption} {axes[side]}."
            )
    return figures


def _rig_layers(
    contents: ReportContents, level: RigidTransform, colours: Mapping[str, Rgb], *, placed: bool
) -> list[Layer]:
    """Return a layer per LiDAR with returns, in the level frame; if `placed`, without unplaced LiDARs."""
    same = {name: RigidTransform.identity(contents.target, name) for name in contents.names}
    poses = contents.poses() if placed else same
    enough = _RIG_POINTS // max(1, len(poses))
    return [
        Layer(
            pose.apply(every_nth(contents.clouds[name], enough)),
            colours[name],
            sensor=pose,
            label=_label(contents, name, placed=placed),
        )
        for name, pose in ((name, level @ pose) for name, pose in poses.items())
        if len(contents.clouds.get(name, ()))
    ]


def _label(contents: ReportContents, name: str, *, placed: bool) -> str:
    return f"{name} (uncertain)" if placed and contents.is_uncertain(name) else name


def pair_figures(
    contents: ReportContents, pair: PairKey, level: RigidTransform, colours: Mapping[str, Rgb]
) -> list[Figure]:
    """Draw a pair from above: the best pose, then the competing one, if any."""
    words = ("at the best pose", "at a competing pose that fits about as well")
    if any(one.key == pair and one.verdict.accepted for one in contents.document.pairs):
        words = ("at the pose of this pair", "at the pose that another accepted pair implies")
    shown = zip(contents.scored.get(pair, ()), words, strict=False)
    return [_pair_figure(contents, one, level, colours, how) for one, how in shown]


def _pair_figure(
    contents: ReportContents, scored: ScoredPoints, level: RigidTransform, colours: Mapping[str, Rgb], words: str
) -> Figure:
    """Draw both clouds, dimmed below the scored points of the source."""
    target, source = scored.T_target_source.target, scored.T_target_source.source
    T_level_target = _levelled(contents, scored.T_target_source, level)
    T_level_source = T_level_target @ scored.T_target_source
    counts = {label: int((scored.labels == label).sum()) for label, _ in _LABEL_COLOURS}
    strength = _DIMMED if any(counts.values()) else 1.0
    layers = [
        Layer(pose.apply(contents.clouds[name]), colours[name], strength, 1, pose, name)
        for name, pose in ((target, T_level_target), (source, T_level_source))
    ]
    points_m = T_level_source.apply(scored.points_m)
    view = top_view(_all_points(layers), _PAIR_SIZE_PX, [T_level_target.xyz_m, T_level_source.xyz_m])
    layers += [
        Layer(points_m[scored.labels == label], colour, dot_px=_SCORED_DOT_PX) for label, colour in _LABEL_COLOURS
    ]
    shown = f"{source} on {target} {words}, from above"
    if len(scored.points_m) == 0:
        return _figure(view, layers, f"{shown}.", f"{shown}, each in its colour.")
    if not any(counts.values()):
        unseen = f"{shown}: neither LiDAR sees a point of the other, so nothing contradicts this pose."
        return _figure(view, layers, unseen, unseen)
    return _figure(
        view,
        layers,
        f"{shown}: {counts[BeamLabel.AGREE]} points agree, {counts[BeamLabel.VIOLATE]} lie in proven-empty space, "
        f"{counts[BeamLabel.OCCLUDED]} are occluded.",
        f"{shown}; large points: points of {source} scored by visibility.",
    )


def _levelled(contents: ReportContents, T_target_source: RigidTransform, level: RigidTransform) -> RigidTransform:
    """Return the pose of the pair's target in the level frame; its own axes if neither LiDAR is placed."""
    placed, target = contents.poses(), T_target_source.target
    if target in placed:
        return level @ placed[target]
    if T_target_source.source in placed:
        return level @ placed[T_target_source.source] @ T_target_source.inverse()
    return RigidTransform.identity(level.target, target)


def _all_points(layers: Sequence[Layer]) -> FloatArray:
    return np.concatenate([np.empty((0, 3)), *(layer.points_m for layer in layers)])


def _figure(view: View, layers: Sequence[Layer], alternative: str, caption: str) -> Figure:
    return Figure(png_bytes(draw_clouds(view, layers)), view.size_px, alternative, caption)
