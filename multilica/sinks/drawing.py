# SPDX-License-Identifier: Apache-2.0
"""Lines, ellipsoids and labels, whatever format they end in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.sinks.palette import Rgb

__all__ = ["Drawing", "Ellipsoid", "Label", "Lines", "segments_along"]


@dataclass(frozen=True, slots=True, eq=False)
class Lines:
    """Segments (K, 2, 3) in metres."""

    segments_m: FloatArray
    colour: Rgb


@dataclass(frozen=True, slots=True, eq=False)
class Ellipsoid:
    """Half axes (3,) in metres along the axes of a pose."""

    pose: RigidTransform
    half_sizes_m: FloatArray
    colour: Rgb


@dataclass(frozen=True, slots=True, eq=False)
class Label:
    """Text that faces whoever looks at it."""

    xyz_m: FloatArray
    text: str
    colour: Rgb


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """What belongs together in one frame.

    Args:
        name: one drawing of a topic has it.
        frame_id: in which all its coordinates are.
    """

    name: str
    frame_id: str
    lines: tuple[Lines, ...] = ()
    ellipsoids: tuple[Ellipsoid, ...] = ()
    labels: tuple[Label, ...] = ()


def segments_along(strip_m: FloatArray) -> FloatArray:
    """(N - 1, 2, 3) the segments of a polyline (N, 3)."""
    return np.stack([strip_m[:-1], strip_m[1:]], axis=1)
