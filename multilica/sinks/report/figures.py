# SPDX-License-Identifier: Apache-2.0
"""Pictures of a report, drawn without a graphics card."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import LEVEL_FRAME, BeamLabel, PairKey
from multilica.sinks.drawing import AGREE, OCCLUDED, VIOLATE, Rgb, every_nth
from multilica.sinks.report.contents import SAME_POSE, ReportContents, ScoredPoints, finalists
from multilica.sinks.report.rig import FIRST_VIEW_RAD, QUARTER_TURN

GROUND_COLOUR: Rgb = (15, 19, 25)
_TEXT_COLOUR: Rgb = (232, 236, 241)
_AXIS_COLOURS: tuple[Rgb, ...] = ((255, 120, 110), (120, 220, 130), (120, 170, 255))
_OPACITY_OF_A_POINT = 0.9
_PALETTE_SIZE = 256
_AXIS_SHARE = 0.04
_MARGIN_PX = 12
_MARGIN = 1.08
_NEARLY_ALL = (0.04, 0.96)
_ENOUGH_POINTS = 20_000
_REACH_M = 50.0
_LEAST_WIDTH_M = 8.0
_MAX_LABEL = 24
_SCALES_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
_WIDTH_PX = 1280
_HEIGHT_SHARES = (0.4, 0.625)
"""Least and most height of a view from above, as shares of the width."""
_OBLIQUE_SIZE_PX = (1000, 562)
_PAIR_SIZE_PX = (1200, 800)
_RIG_DOT_PX = 2
_SCORED_DOT_PX = 5
_RIG_POINTS = 400_000
"""More change little that can be seen."""
_DIMMED = 0.6
_LABEL_COLOURS: tuple[tuple[BeamLabel, Rgb], ...] = (
    (BeamLabel.OCCLUDED, OCCLUDED),
    (BeamLabel.AGREE, AGREE),
    (BeamLabel.VIOLATE, VIOLATE),
)


class View(NamedTuple):
    """A parallel projection along an axis.

    Args:
        right, up: indices of the coordinates that point right and up.
        centre_m: (2,) these coordinates at the centre of the picture.
        width_m: of the picture.
        size_px: width and height.
    """

    right: int
    up: int
    centre_m: tuple[float, float]
    width_m: float
    size_px: tuple[int, int]

    @property
    def pixels_per_m(self) -> float:
        """Return the scale."""
        return self.size_px[0] / self.width_m

    @property
    def text_px(self) -> int:
        """Return the height of text."""
        return max(12, self.size_px[0] // 55)

    def project(self, points_m: FloatArray) -> FloatArray:
        """Return pixel coordinates (N, 2), right and down, of points (N, 3)."""
        offset_m = points_m[:, (self.right, self.up)] - self.centre_m
        middle_px = np.array(self.size_px) / 2.0
        return np.asarray(middle_px + self.pixels_per_m * offset_m * (1.0, -1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """One cloud of a picture.

    Args:
        points_m: (N, 3) in the picture's frame.
        strength: brightness of the points, from 0 to 1.
        dot_px: side of the square drawn for a point.
        sensor: pose of the sensor's axes; None to draw none.
        label: drawn beside the sensor.
    """

    points_m: FloatArray
    colour: Rgb
    strength: float = 1.0
    dot_px: int = 1
    sensor: RigidTransform | None = None
    label: str = ""

    def moved(self, T_view_layer: RigidTransform) -> Self:
        """Return the layer in another frame."""
        sensor = None if self.sensor is None else T_view_layer @ self.sensor
        return replace(self, points_m=T_view_layer.apply(self.points_m), sensor=sensor)


def top_view(points_m: FloatArray, size_px: tuple[int, int], sensors_m: Sequence[FloatArray] = ()) -> View:
    """Return a view from above, x to the right, of nearly all points (N, 3), the origin and these sensors."""
    low_m, high_m = _extent_m(points_m)
    corners_m = np.stack([low_m, high_m, *sensors_m])
    low_m, high_m = corners_m.min(axis=0), corners_m.max(axis=0)
    span_m = _MARGIN * (high_m - low_m)
    width_m = max(span_m[0], span_m[1] * size_px[0] / size_px[1], _LEAST_WIDTH_M)
    centre_m = (low_m + high_m) / 2.0
    return View(0, 1, (float(centre_m[0]), float(centre_m[1])), float(width_m), size_px)


def fitted_height_px(points_m: FloatArray, width_px: int, least: float, most: float) -> int:
    """Return the height of a top view that nearly all points (N, 3) fill, within two shares of the width."""
    low_m, high_m = _extent_m(points_m)
    width_m, height_m, _ = np.maximum(high_m - low_m, 1.0)
    return round(width_px * float(np.clip(height_m / width_m, least, most)))


def side_view(points_m: FloatArray, width_px: int) -> View:
    """Return a view along y, x to the right, z up, of nearly all points (N, 3)."""
    low_m, high_m = _extent_m(points_m)
    width_m = max(_MARGIN * (high_m[0] - low_m[0]), _LEAST_WIDTH_M)
    height_m = float(np.clip(_MARGIN * (high_m[2] - low_m[2]), width_m / 6.0, width_m / 2.0))
    centre_m = (float(low_m[0] + high_m[0]) / 2.0, float(low_m[2]) + 0.4 * height_m)
    return View(0, 2, centre_m, width_m, (width_px, round(width_px * height_m / width_m)))


def _extent_m(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and highest coordinates (3,) of nearly all points and the origin."""
    if len(points_m) == 0:
        return np.zeros(3), np.zeros(3)
    low_m, high_m = np.quantile(every_nth(points_m, _ENOUGH_POINTS), _NEARLY_ALL, axis=0)
    return np.clip(low_m, -_REACH_M, 0.0), np.clip(high_m, 0.0, _REACH_M)


def draw_clouds(view: View, layers: Sequence[Layer]) -> Image.Image:
    """Draw all layers blended, so that none hides another; then sensors, labels and a scale."""
    image = Image.fromarray(_blend(view, layers))
    pen = ImageDraw.Draw(image)
    for layer in layers:
        if layer.sensor is not None:
            _draw_axes(pen, view, layer.sensor)
    _draw_labels(pen, view, layers)
    _draw_scale(pen, view)
    return image


def short_name(name: str, letters: int) -> str:
    """Return a name in one line without the middle of a long one: beginning and end tell LiDARs apart."""
    name = " ".join(name.split())
    half = (letters - 3) // 2
    return name if len(name) <= letters else f"{name[:half]}...{name[-half:]}"


def png_bytes(image: Image.Image) -> bytes:
    """Encode as PNG with a palette, which halves the size."""
    buffer = io.BytesIO()
    palette = image.quantize(_PALETTE_SIZE, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    palette.save(buffer, "PNG", compress_level=4)
    return buffer.getvalue()


def _blend(view: View, layers: Sequence[Layer]) -> npt.NDArray[np.uint8]:
    """Return pixels (H, W, 3) in the mean colour of their points, more opaque with more points."""
    width, height = view.size_px
    cells = [_cells(view, layer) for layer in layers]
    total = np.bincount(np.concatenate([np.empty(0, dtype=np.int64), *cells]), minlength=width * height)
    hit = np.flatnonzero(total > 0)
    places, total = np.empty_like(total), total[hit]
    places[hit] = np.arange(len(hit))
    counts = [np.bincount(places[each], minlength=len(hit)) for each in cells]
    opacity = 1.0 - (1.0 - _OPACITY_OF_A_POINT) ** np.arange(total.max(initial=0) + 1)
    lights = np.array([layer.strength * np.array(layer.colour) for layer in layers]).reshape(len(layers), 3)
    mean = np.array(counts, dtype=np.float64).reshape(len(layers), len(hit)).T @ lights / total[:, None]
    pixels = np.full((width * height, 3), GROUND_COLOUR, dtype=np.uint8)
    pixels[hit] = np.rint(GROUND_COLOUR + opacity[total][:, None] * (mean - GROUND_COLOUR))
    return pixels.reshape(height, width, 3)


def _cells(view: View, layer: Layer) -> npt.NDArray[np.int64]:
    """Return the flat pixel index (K,) of every dot, with repetitions."""
    width, height = view.size_px
    x, y = np.floor(view.project(layer.points_m)).T
    steps = np.arange(layer.dot_px) - layer.dot_px // 2
    right, down = (each.reshape(-1, 1) for each in np.meshgrid(steps, steps))
    x, y = x + right, y + down
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    return np.asarray(y[inside] * width + x[inside], dtype=np.int64)


def _draw_axes(pen: ImageDraw.ImageDraw, view: View, sensor: RigidTransform) -> None:
    length_m = _AXIS_SHARE * min(view.size_px) / view.pixels_per_m
    ends = view.project(np.vstack([sensor.xyz_m, sensor.xyz_m + length_m * sensor.rotation.T]))
    for axis, colour in enumerate(_AXIS_COLOURS):
        pen.line([tuple(ends[0]), tuple(ends[axis + 1])], fill=colour, width=3)
    x, y = ends[0]
    pen.ellipse([x - 3, y - 3, x + 3, y + 3], fill=_TEXT_COLOUR)


def _draw_labels(pen: ImageDraw.ImageDraw, view: View, layers: Sequence[Layer]) -> None:
    """Draw names in a column beside the sensors, with leader lines: sensors of a vehicle are close together."""
    labelled = [layer for layer in layers if layer.sensor is not None and layer.label]
    if not labelled:
        return
    font = ImageFont.load_default(view.text_px)
    places = view.project(np.array([layer.sensor.xyz_m for layer in labelled if layer.sensor is not None]))
    order = np.argsort(np.round(places[:, 1], 3), kind="stable")  # sensors at one height: by name
    spacing = 1.3 * view.text_px
    top = float(np.clip(places[:, 1].mean() - spacing * (len(order) - 1) / 2.0, spacing, view.size_px[1]))
    column = places[:, 0].max() + 2.5 * spacing
    for row, index in enumerate(order):
        layer, y = labelled[index], top + row * spacing
        pen.line([tuple(places[index]), (column - 4, y)], fill=layer.colour, width=1)
        text = short_name(layer.label, _MAX_LABEL)
        pen.text((column, y), text, layer.colour, font, anchor="lm", stroke_width=3, stroke_fill=GROUND_COLOUR)


def _draw_scale(pen: ImageDraw.ImageDraw, view: View) -> None:
    length_m = max(scale for scale in _SCALES_M if scale <= max(view.width_m / 5.0, _SCALES_M[0]))
    x, y = _MARGIN_PX, view.size_px[1] - _MARGIN_PX
    end = x + length_m * view.pixels_per_m
    pen.line([(x, y), (end, y)], fill=_TEXT_COLOUR, width=2)
    font, text = ImageFont.load_default(view.text_px), f"{length_m:g} m"
    pen.text((end + 6, y), text, _TEXT_COLOUR, font, anchor="ls", stroke_width=2, stroke_fill=GROUND_COLOUR)


class Figure(NamedTuple):
    """A PNG picture with its alternative text and caption."""

    png: bytes
    size_px: tuple[int, int]
    alternative: str
    caption: str

    @property
    def address(self) -> str:
        """Return the picture as a `data:` URL."""
        return f"data:image/png;base64,{base64.b64encode(self.png).decode('ascii')}"


def rig_figures(contents: ReportContents, *, calibrated: bool) -> dict[str, Figure]:
    """Draw all clouds before and, if calibrated, after: `top_before`, `top_after`, `side_...`, and `oblique`."""
    before = _rig_layers(contents, placed=False)
    after = _rig_layers(contents, placed=True) if calibrated else before
    figures = {"oblique": _oblique_figure(after, "as placed" if calibrated else "as recorded")}
    axes = {"top": "Seen from above: x to the right, y up", "side": "Seen from the right: x to the right, z up"}
    low_m, high_m = _extent_m(_all_points(after))
    if high_m[1] - low_m[1] > high_m[0] - low_m[0]:
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


def _rig_layers(contents: ReportContents, *, placed: bool) -> list[Layer]:
    """Return a layer per LiDAR with returns, in the level frame; if `placed`, without unplaced LiDARs."""
    same = {name: RigidTransform.identity(contents.target, name) for name in contents.document.lidars}
    poses = contents.document.poses if placed else same
    enough = _RIG_POINTS // max(1, len(poses))
    return [
        Layer(
            pose.apply(every_nth(contents.clouds[name], enough)),
            contents.colours[name],
            dot_px=_RIG_DOT_PX,
            sensor=pose,
            label=f"{name} (uncertain)" if placed and contents.document.lidars[name].status == "uncertain" else name,
        )
        for name, pose in ((name, contents.shown_level @ pose) for name, pose in poses.items())
        if len(contents.clouds.get(name, ()))
    ]


def pair_figures(contents: ReportContents, pair: PairKey) -> list[Figure]:
    """Draw a pair from above: the best pose, then the competing one, if any."""
    scored = contents.scored.get(pair, ())
    entry = next((one for one in contents.document.pairs if one.key == pair), None)
    own = [] if entry is None else finalists(entry)
    others = [one.T_target_source for one in scored[1:2]]
    ranks = (rank for rank, pose in enumerate(own) for one in others if max(pose.distance_to(one)) < SAME_POSE)
    named = {None: "at a competing pose that other pairs imply", 1: "at the next best pose"}
    words = ("at the best pose", named.get(next(ranks, None), "at the competing pose"))
    if entry is not None and entry.verdict.accepted:
        words = ("at the pose of this pair", "at the pose that another accepted pair implies")
    return [_pair_figure(contents, one, how) for one, how in zip(scored, words, strict=False)]


def _pair_figure(contents: ReportContents, scored: ScoredPoints, words: str) -> Figure:
    """Draw both clouds, dimmed below their scored points."""
    target, source = scored.T_target_source.target, scored.T_target_source.source
    T_level_target, colours = _levelled(contents, scored.T_target_source), contents.colours
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


def _levelled(contents: ReportContents, T_target_source: RigidTransform) -> RigidTransform:
    """Return the pose of the pair's target in the level frame; its own axes if neither LiDAR is placed."""
    placed, target, level = contents.document.poses, T_target_source.target, contents.shown_level
    if target in placed:
        return level @ placed[target]
    if T_target_source.source in placed:
        return level @ placed[T_target_source.source] @ T_target_source.inverse()
    return RigidTransform.identity(level.target, target)


def _all_points(layers: Sequence[Layer]) -> FloatArray:
    return np.concatenate([np.empty((0, 3)), *(layer.points_m for layer in layers)])


def _figure(view: View, layers: Sequence[Layer], alternative: str, caption: str) -> Figure:
    return Figure(png_bytes(draw_clouds(view, layers)), view.size_px, alternative, caption)
