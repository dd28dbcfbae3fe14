# SPDX-License-Identifier: Apache-2.0
"""Drawing primitives independent of any file format."""

from dataclasses import dataclass

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.sinks.drawing.palette import Rgb

EDGE_LABEL_SHARE = 0.4
"""Position of labels along the edges of graphs; off the middle, where the diagonals of a square meet."""


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
    """Text that faces the camera."""

    xyz_m: FloatArray
    text: str
    colour: Rgb


@dataclass(frozen=True, slots=True, eq=False)
class Drawing:
    """Primitives in one frame; `name` is unique in a topic."""

    name: str
    frame_id: str
    lines: tuple[Lines, ...] = ()
    ellipsoids: tuple[Ellipsoid, ...] = ()
    labels: tuple[Label, ...] = ()


def segments_along(strip_m: FloatArray) -> FloatArray:
    """Return the segments (N - 1, 2, 3) of a polyline (N, 3)."""
    return np.stack([strip_m[:-1], strip_m[1:]], axis=1)
