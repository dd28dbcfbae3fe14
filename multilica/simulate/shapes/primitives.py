# SPDX-License-Identifier: Apache-2.0
"""Boxes, cylinders, sheets, extrusions."""

from collections.abc import Callable, Sequence

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray
from multilica.simulate.shapes.mesh import Mesh, facing_quads, merged, quads

__all__ = ["Rectangle", "box", "cylinder", "extrusion", "facets", "sheet", "sphere", "tapered_box", "tube"]

_FACES = np.array([[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])

Point = Sequence[float]
Rectangle = tuple[float, float, float, float]
"""(x0, x1, y0, y1) in metres."""


def box(low_m: Point, high_m: Point) -> Mesh:
    """Build an axis-parallel box between two corners."""
    rectangle = (low_m[0], high_m[0], low_m[1], high_m[1])
    return tapered_box(rectangle, rectangle, low_m[2], high_m[2])


def tapered_box(bottom_m: Rectangle, top_m: Rectangle, z0_m: float, z1_m: float) -> Mesh:
    """Build a box whose bottom and top rectangles differ: car bodies, greenhouses, heaps."""
    corners = [
        [x, y, z]
        for (x0, x1, y0, y1), z in ((bottom_m, z0_m), (top_m, z1_m))
        for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    ]
    return quads(np.array(corners)[_FACES])


def cylinder(radius_m: float, z0_m: float, z1_m: float, top_radius_m: float | None = None, sides: int = 12) -> Mesh:
    """Build an upright cylinder about the z axis, or a cone if the top radius differs; closed by its caps."""
    bottom = _circle(radius_m, z0_m, sides)
    top = _circle(radius_m if top_radius_m is None else top_radius_m, z1_m, sides)
    caps = [facing_quads(np.broadcast_to(ring.mean(axis=0), ring.shape), ring) for ring in (bottom, top)]
    return merged([facing_quads(bottom, top), *caps])


def _circle(radius_m: float, z_m: float, sides: int) -> FloatArray:
    angles = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    return np.column_stack([radius_m * np.cos(angles), radius_m * np.sin(angles), np.full(sides + 1, z_m)])


def tube(start_m: Point, end_m: Point, radius_m: float, sides: int = 8) -> Mesh:
    """Build a cylinder between any two points: pipes, rails, branches."""
    start = np.asarray(start_m, dtype=np.float64)
    axis = np.asarray(end_m, dtype=np.float64) - start
    length_m = float(np.linalg.norm(axis))
    pitch = float(np.arctan2(np.hypot(axis[0], axis[1]), axis[2]))
    yaw = float(np.arctan2(axis[1], axis[0]))
    return cylinder(radius_m, 0.0, length_m, sides=sides).rotated((0.0, pitch, yaw), (start[0], start[1], start[2]))


def sphere(radii_m: Point, centre_m: Point, sides: int = 10) -> Mesh:
    """Build an ellipsoid with its axes along x, y, z."""
    polar = np.linspace(0.0, np.pi, sides // 2 + 1)
    around = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    ring, turn = np.meshgrid(polar, around, indexing="ij")
    unit = np.stack([np.sin(ring) * np.cos(turn), np.sin(ring) * np.sin(turn), np.cos(ring)], axis=-1)
    points = unit * np.asarray(radii_m) + np.asarray(centre_m)
    return merged([facing_quads(points[row], points[row + 1]) for row in range(len(polar) - 1)])


def sheet(x_m: npt.ArrayLike, y_m: npt.ArrayLike, height_m: Callable[[FloatArray, FloatArray], FloatArray]) -> Mesh:
    """Build a surface over the grid of x (X,) and y (Y,) from its height function."""
    x, y = np.meshgrid(np.asarray(x_m, dtype=np.float64), np.asarray(y_m, dtype=np.float64), indexing="ij")
    points = np.stack([x, y, np.broadcast_to(height_m(x, y), x.shape)], axis=-1)
    return merged([facing_quads(points[row], points[row + 1]) for row in range(len(points) - 1)])


def extrusion(profile_yz_m: npt.ArrayLike, x0_m: float, x1_m: float) -> Mesh:
    """Extrude a polyline (K, 2) of y and z along x: arches, kerbs, hedges."""
    profile = np.asarray(profile_yz_m, dtype=np.float64)
    ends = [np.column_stack([np.full(len(profile), x), profile]) for x in (x0_m, x1_m)]
    return facing_quads(ends[0], ends[1])


def facets(centres_m: FloatArray, size_m: float, rng: np.random.Generator) -> Mesh:
    """Build a triangle of random attitude at each centre (N, 3): leaves, grass."""
    corners = centres_m[:, None, :] + rng.normal(scale=size_m, size=(len(centres_m), 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(centres_m)).reshape(-1, 3))
