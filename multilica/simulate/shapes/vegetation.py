# SPDX-License-Identifier: Apache-2.0
"""Trees, bushes, hedges."""

import numpy as np

from multilica.geometry import FloatArray
from multilica.simulate.shapes.mesh import Mesh, merged
from multilica.simulate.shapes.primitives import box, cylinder, facets, tube

__all__ = ["bush", "hedge", "tree"]


def tree(rng: np.random.Generator, height_m: float) -> Mesh:
    """Build a trunk, some branches, and a crown of leaf-sized facets that lets part of the beams through."""
    trunk_top_m = height_m * rng.uniform(0.3, 0.45)
    radius_m = 0.03 * height_m * rng.uniform(0.6, 1.1)
    lean = rng.normal(scale=0.03, size=2)
    trunk = cylinder(radius_m, -0.3, height_m * 0.75, top_radius_m=0.3 * radius_m)
    crown_m = np.array([0.28, 0.28, 0.34]) * height_m * rng.uniform(0.75, 1.2, size=3)
    centre = np.array([0.0, 0.0, height_m - crown_m[2]])
    ends = centre + rng.uniform(-0.7, 0.7, size=(5, 3)) * crown_m
    branches = [tube((0.0, 0.0, trunk_top_m), end, 0.25 * radius_m, sides=5) for end in ends.tolist()]
    leaves = facets(_crown_points(rng, 420, crown_m) + centre, 0.16, rng)
    return merged([trunk, *branches, leaves]).rotated((lean[0], lean[1], rng.uniform(0.0, 2.0 * np.pi)))


def _crown_points(rng: np.random.Generator, count: int, radii_m: FloatArray) -> FloatArray:
    """Draw points in an ellipsoid with lumps, denser near its surface."""
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lumps = rng.normal(size=(6, 3))
    shells = 0.75 + 0.25 * np.tanh(directions @ lumps.T).max(axis=1)
    return np.asarray(directions * (shells * rng.uniform(0.35, 1.0, size=count))[:, None] * radii_m)


def bush(rng: np.random.Generator, radius_m: float) -> Mesh:
    """Build a low dome of facets."""
    radii = radius_m * rng.uniform(0.7, 1.2, size=3)
    points = _crown_points(rng, 160, radii)
    points[:, 2] = np.abs(points[:, 2])
    return facets(points, 0.1 + 0.04 * radius_m, rng)


def hedge(rng: np.random.Generator, length_m: float, height_m: float) -> Mesh:
    """Build a trimmed hedge along x from the origin, rough on all sides."""
    width_m = 0.9
    core = box((0.0, -width_m / 2.0 + 0.12, 0.0), (length_m, width_m / 2.0 - 0.12, height_m - 0.12))
    count = int(70 * length_m * height_m)
    points = rng.uniform([0.0, -0.5, 0.0], [length_m, 0.5, height_m], size=(count, 3))
    on_top = rng.random(count) < width_m / (width_m + 2.0 * height_m)
    points[:, 1] = np.where(on_top, points[:, 1] * width_m, np.copysign(width_m / 2.0, points[:, 1]))
    points[on_top, 2] = height_m
    return merged([core, facets(points, 0.08, rng)])
