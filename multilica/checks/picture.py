# SPDX-License-Identifier: Apache-2.0
"""Picture of a check: how far each LiDAR is from its reference, as a share of its tolerance."""

import io
from collections.abc import Sequence

from PIL import Image, ImageDraw, ImageFont

from multilica.checks.comparison import CheckVerdict, LidarCheck, RigCheck

_WIDTH_PX, _ROW_PX, _MARGIN_PX, _NAME_PX, _FONT_PX = 960, 44, 24, 220, 16
# The scale ends at twice the tolerance.
_FULL_SHARE = 2.0
_COLOURS: dict[CheckVerdict, str] = {"within": "#2e8b57", "outside": "#c8322b", "undecided": "#b8860b"}
_INK, _GRID, _PAPER = "#222222", "#bbbbbb", "#ffffff"


def check_png(rigs: Sequence[RigCheck]) -> bytes:
    """Draw two bars per LiDAR, translation above rotation, with the tolerance as a line and sigma as a whisker."""
    rows = [(rig, check) for rig in rigs for check in rig.lidars]
    height = 2 * _MARGIN_PX + _ROW_PX * (len(rows) + len(rigs)) + _ROW_PX
    image = Image.new("RGB", (_WIDTH_PX, height), _PAPER)
    pen = ImageDraw.Draw(image)
    font = ImageFont.load_default(_FONT_PX)
    y = _MARGIN_PX
    for rig in rigs:
        pen.text((_MARGIN_PX, y), f"{rig.name}: {rig.verdict}, compared to {rig.root}", fill=_INK, font=font)
        y += _ROW_PX
        for check in rig.lidars:
            pen.text((_MARGIN_PX, y + 6), check.lidar, fill=_COLOURS[check.verdict], font=font)
            _draw_bars(pen, check, y)
            y += _ROW_PX
    for share, label in ((0.0, "0"), (1.0, "tolerance"), (_FULL_SHARE, "2 x")):
        x = _x(share)
        pen.line((x, _MARGIN_PX + _ROW_PX, x, y), fill=_INK if share == 1.0 else _GRID, width=2 if share == 1.0 else 1)
        pen.text((x, y + 6), label, fill=_INK, font=font, anchor="ma")
    stream = io.BytesIO()
    image.save(stream, "PNG", optimize=True)
    return stream.getvalue()


def _x(share: float) -> float:
    left = _MARGIN_PX + _NAME_PX
    return left + (_WIDTH_PX - 2 * _MARGIN_PX - left) * min(share, _FULL_SHARE) / _FULL_SHARE


def _draw_bars(pen: ImageDraw.ImageDraw, check: LidarCheck, y: int) -> None:
    if check.distance_m is None or check.angle_deg is None:
        pen.text(
            (_x(0.0) + 8, y + 6), "not placed", fill=_COLOURS[check.verdict], font=ImageFont.load_default(_FONT_PX)
        )
        return
    of_translation = check.distance_m, check.sigma_m, check.max_translation_m
    of_rotation = check.angle_deg, check.sigma_deg, check.max_rotation_deg
    for top, (off, sigma, limit) in zip((y + 4, y + 20), (of_translation, of_rotation), strict=True):
        pen.rectangle((_x(0.0), top, max(_x(off / limit), _x(0.0) + 1), top + 12), fill=_COLOURS[check.verdict])
        if sigma is not None:
            ends = _x(max(0.0, off - sigma) / limit), _x((off + sigma) / limit)
            pen.line((ends[0], top + 6, ends[1], top + 6), fill=_INK, width=2)
