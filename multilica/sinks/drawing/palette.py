# SPDX-License-Identifier: Apache-2.0
"""Colours that are distinct for any colour vision on a dark background."""

from collections.abc import Iterable

import numpy as np
import numpy.typing as npt

Rgb = tuple[int, int, int]

# After Okabe and Ito's set; its vermillion is kept for what is wrong.
_DISTINCT: tuple[Rgb, ...] = (
    (86, 180, 233),
    (230, 159, 0),
    (204, 121, 167),
    (240, 228, 66),
    (0, 158, 115),
    (120, 140, 255),
    (200, 200, 200),
    (160, 110, 60),
)
KEPT: Rgb = (120, 230, 170)
REJECTED: Rgb = (86, 48, 42)
AGREE: Rgb = (120, 230, 170)
VIOLATE: Rgb = (213, 94, 0)
OCCLUDED: Rgb = (110, 110, 120)
UNSEEN: Rgb = (45, 47, 52)
UNDECIDED: Rgb = (240, 180, 60)
UNCERTAIN: Rgb = (110, 170, 255)
MUTED: Rgb = (110, 110, 120)
VERDICT_COLOURS: dict[str, Rgb] = {"accept": AGREE, "uncertain": UNCERTAIN, "undecided": UNDECIDED, "reject": VIOLATE}

_HEAT_STOPS = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37))


def distinct_colours(names: Iterable[str]) -> dict[str, Rgb]:
    """Return a colour per name by its position."""
    return {name: _DISTINCT[index % len(_DISTINCT)] for index, name in enumerate(names)}


def hex_colour(colour: Rgb) -> str:
    """Format a colour as ``#rrggbb``."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def heat_colours(shares: npt.NDArray[np.float64]) -> npt.NDArray[np.uint8]:
    """Return viridis colours (..., 3) of shares (...) from 0 to 1; NaN is dark grey."""
    positions = np.linspace(0.0, 1.0, len(_HEAT_STOPS))
    known = np.clip(np.nan_to_num(shares), 0.0, 1.0)
    channels = [np.interp(known, positions, channel) for channel in zip(*_HEAT_STOPS, strict=True)]
    colours = np.stack(channels, axis=-1)
    colours[np.isnan(shares)] = 45.0
    return colours.astype(np.uint8)
