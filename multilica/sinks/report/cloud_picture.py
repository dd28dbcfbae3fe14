# SPDX-License-Identifier: Apache-2.0
"""Pictures of point clouds, drawn without a graphics card."""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from multilica.geometry import FloatArray, RigidTransform
from multilica.sinks.drawing.palette import Rgb
from multilica.sinks.drawing.shapes import every_nth

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


@dataclass(frozen=True, slots=True, eq=False)
class View:
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


def is_upright(points_m: FloatArray) -> bool:
    """Return whether nearly all points (N, 3) extend farther along y than along x."""
    low_m, high_m = _extent_m(points_m)
    return bool(high_m[1] - low_m[1] > high_m[0] - low_m[0])


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
    counts = [np.bincount(places[each], minlength=len(hit)).astype(np.float64) for each in cells]
    opacity = 1.0 - (1.0 - _OPACITY_OF_A_POINT) ** np.arange(total.max(initial=0) + 1)
    pixels = np.empty((width * height, 3), dtype=np.uint8)
    for channel, ground in enumerate(GROUND_COLOUR):
        lights = (count * (layer.strength * layer.colour[channel]) for count, layer in zip(counts, layers, strict=True))
        mean = sum(lights, np.zeros(len(hit))) / total
        pixels[:, channel] = ground
        pixels[hit, channel] = np.rint(ground + opacity[total] * (mean - ground))
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
