# SPDX-License-Identifier: Apache-2.0
"""Point clouds as pictures, drawn without a graphics card."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from textwrap import shorten

import numpy as np
import numpy.typing as npt
from PIL import Image, ImageDraw, ImageFont

from multilica.geometry import FloatArray, RigidTransform
from multilica.sinks.palette import Rgb
from multilica.sinks.thinning import every_nth

__all__ = ["GROUND_COLOUR", "Layer", "View", "draw_clouds", "png_bytes", "side_view", "top_view"]

GROUND_COLOUR: Rgb = (15, 19, 25)
_TEXT_COLOUR: Rgb = (232, 236, 241)
_AXIS_COLOURS: tuple[Rgb, ...] = ((255, 120, 110), (120, 220, 130), (120, 170, 255))
_OPACITY_OF_A_POINT = 0.7
_PALETTE_SIZE = 256
_AXIS_SHARE = 0.04
_MARGIN_PX = 12
_MARGIN = 1.08
_NEARLY_ALL = (0.04, 0.96)
_ENOUGH_POINTS = 20_000
_REACH_M = 50.0
_LEAST_WIDTH_M = 8.0
_MAX_LABEL = 40
_SCALES_M = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A parallel projection along an axis.

    Args:
        right, up: which coordinate grows to the right, and which upwards.
        centre_m: (2,) those coordinates in the middle of the picture.
        width_m: from the left edge to the right one.
        size_px: width and height.
    """

    right: int
    up: int
    centre_m: tuple[float, float]
    width_m: float
    size_px: tuple[int, int]

    @property
    def pixels_per_m(self) -> float:
        """The scale."""
        return self.size_px[0] / self.width_m

    def project(self, points_m: FloatArray) -> FloatArray:
        """Pixel coordinates (N, 2), to the right and downwards, of points (N, 3)."""
        offset_m = points_m[:, (self.right, self.up)] - self.centre_m
        middle_px = np.array(self.size_px) / 2.0
        return np.asarray(middle_px + self.pixels_per_m * offset_m * (1.0, -1.0))


@dataclass(frozen=True, slots=True, eq=False)
class Layer:
    """One cloud of a picture.

    Args:
        points_m: (N, 3) in the picture's frame.
        strength: of the points' colour, from 0 to 1; the label has all of it.
        dot_px: side of the square that a point becomes.
        sensor: where to draw the sensor's frame; None to draw none.
        label: beside the sensor.
    """

    points_m: FloatArray
    colour: Rgb
    strength: float = 1.0
    dot_px: int = 1
    sensor: RigidTransform | None = None
    label: str = ""


def top_view(points_m: FloatArray, size_px: tuple[int, int], sensors_m: Sequence[FloatArray] = ()) -> View:
    """From above, x to the right, wide enough for nearly all points (N, 3) with the origin and these sensors."""
    low_m, high_m = _extent_m(points_m)
    corners_m = np.stack([low_m, high_m, *sensors_m])
    low_m, high_m = corners_m.min(axis=0), corners_m.max(axis=0)
    span_m = _MARGIN * (high_m - low_m)
    width_m = max(span_m[0], span_m[1] * size_px[0] / size_px[1], _LEAST_WIDTH_M)
    centre_m = (low_m + high_m) / 2.0
    return View(0, 1, (float(centre_m[0]), float(centre_m[1])), float(width_m), size_px)


def side_view(points_m: FloatArray, width_px: int) -> View:
    """From the right side, x to the right, z up; as high as the points (N, 3) need."""
    low_m, high_m = _extent_m(points_m)
    width_m = max(_MARGIN * (high_m[0] - low_m[0]), _LEAST_WIDTH_M)
    height_m = float(np.clip(_MARGIN * (high_m[2] - low_m[2]), width_m / 6.0, width_m / 2.0))
    centre_m = (float(low_m[0] + high_m[0]) / 2.0, float(low_m[2]) + 0.4 * height_m)
    return View(0, 2, centre_m, width_m, (width_px, round(width_px * height_m / width_m)))


def _extent_m(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(3,) lowest and highest coordinates of nearly all points; the origin, where the target sits, is among them."""
    if len(points_m) == 0:
        return np.zeros(3), np.zeros(3)
    low_m, high_m = np.quantile(every_nth(points_m, _ENOUGH_POINTS), _NEARLY_ALL, axis=0)
    return np.clip(low_m, -_REACH_M, 0.0), np.clip(high_m, 0.0, _REACH_M)


def draw_clouds(view: View, layers: Sequence[Layer]) -> Image.Image:
    """All layers through one another, none hides the others; then the sensors with their labels, and a scale."""
    image = Image.fromarray(_blend(view, layers))
    pen = ImageDraw.Draw(image)
    for layer in layers:
        if layer.sensor is not None:
            _draw_axes(pen, view, layer.sensor)
    _draw_labels(pen, view, layers)
    _draw_scale(pen, view)
    return image


def png_bytes(image: Image.Image) -> bytes:
    """The picture as PNG with a palette: less than half of the size."""
    buffer = io.BytesIO()
    palette = image.quantize(_PALETTE_SIZE, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    palette.save(buffer, "PNG", compress_level=4)
    return buffer.getvalue()


def _blend(view: View, layers: Sequence[Layer]) -> npt.NDArray[np.uint8]:
    """(H, W, 3): each pixel the mean colour of its points, the more opaque the more they are."""
    width, height = view.size_px
    cells = [_cells(view, layer) for layer in layers]
    counts = np.array([len(each) for each in cells], dtype=np.int64)
    dots = np.concatenate([np.empty(0, dtype=np.int64), *cells])
    total = np.bincount(dots, minlength=width * height)
    hit = np.flatnonzero(total)
    opacity = 1.0 - (1.0 - _OPACITY_OF_A_POINT) ** np.arange(total.max() + 1)
    pixels = np.empty((width * height, 3), dtype=np.uint8)
    for channel, ground in enumerate(GROUND_COLOUR):
        values = np.array([layer.strength * layer.colour[channel] for layer in layers])
        mean = np.bincount(dots, np.repeat(values, counts), width * height)[hit] / total[hit]
        pixels[:, channel] = ground
        pixels[hit, channel] = np.rint(ground + opacity[total[hit]] * (mean - ground))
    return pixels.reshape(height, width, 3)


def _cells(view: View, layer: Layer) -> npt.NDArray[np.int64]:
    """(K,) which pixel, of those row by row, each point colours; one several times where several points do."""
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
    """Names in a column beside the sensors, each with a line to its own: sensors of a vehicle lie close together."""
    labelled = [layer for layer in layers if layer.sensor is not None and layer.label]
    if not labelled:
        return
    font = _font(view)
    places = view.project(np.array([layer.sensor.xyz_m for layer in labelled if layer.sensor is not None]))
    order = np.argsort(places[:, 1], kind="stable")
    spacing = 1.3 * _text_px(view)
    top = float(np.clip(places[:, 1].mean() - spacing * (len(order) - 1) / 2.0, spacing, view.size_px[1]))
    column = places[:, 0].max() + 2.5 * spacing
    for row, index in enumerate(order):
        layer, y = labelled[index], top + row * spacing
        pen.line([tuple(places[index]), (column - 4, y)], fill=layer.colour, width=1)
        text = shorten(layer.label, _MAX_LABEL)  # a name may hold line breaks, which no label can
        pen.text((column, y), text, layer.colour, font, anchor="lm", stroke_width=3, stroke_fill=GROUND_COLOUR)


def _draw_scale(pen: ImageDraw.ImageDraw, view: View) -> None:
    length_m = max(scale for scale in _SCALES_M if scale <= max(view.width_m / 5.0, _SCALES_M[0]))
    x, y = _MARGIN_PX, view.size_px[1] - _MARGIN_PX
    end = x + length_m * view.pixels_per_m
    pen.line([(x, y), (end, y)], fill=_TEXT_COLOUR, width=2)
    font = _font(view)
    pen.text(
        (end + 6, y), f"{length_m:g} m", _TEXT_COLOUR, font, anchor="ls", stroke_width=2, stroke_fill=GROUND_COLOUR
    )


def _font(view: View) -> ImageFont.FreeTypeFont | ImageFont.ImageFont:
    return ImageFont.load_default(_text_px(view))


def _text_px(view: View) -> int:
    return max(12, view.size_px[0] // 55)
