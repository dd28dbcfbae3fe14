# SPDX-License-Identifier: Apache-2.0
"""Outlines of what a LiDAR sees, from its own returns."""

from __future__ import annotations

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from multilica.geometry import FloatArray
from multilica.sinks.run_story import RunStory

__all__ = ["field_of_view", "shown_field_of_view"]

_RADIUS_M = 2.0
_LARGEST_GAP_RAD = float(np.deg2rad(20.0))
_STEP_RAD = float(np.deg2rad(3.0))
_MAX_RAYS = 8
_MAX_RETURNS = 20_000


def shown_field_of_view(story: RunStory, lidar: str) -> tuple[FloatArray, ...]:
    """That of a LiDAR whose cloud is preprocessed, computed once."""
    if lidar not in story.outlines:
        story.outlines[lidar] = field_of_view(story.clouds[lidar].returns_m)
    return story.outlines[lidar]


def field_of_view(returns_m: FloatArray, radius_m: float = _RADIUS_M) -> tuple[FloatArray, ...]:
    """The convex outline, in azimuth and elevation, of a LiDAR's returns.

    A LiDAR that sees all around, with no gap of 20 degrees, gets a circle at its lowest and its highest elevation.
    Where the sky returns nothing, the outline ends with the highest thing that stood there.

    Args:
        returns_m: (N, 3) in the sensor's own frame.
        radius_m: distance at which the outline is drawn.

    Returns:
        Polylines (K, 3): the outline, or both circles, then rays from the sensor to it; none if the returns span
        no area.
    """
    stride = max(1, len(returns_m) // _MAX_RETURNS)
    directions = returns_m[::stride]
    directions = directions[np.linalg.norm(directions, axis=1) > 0.0]
    if len(directions) < 3:
        return ()
    azimuth_rad = np.arctan2(directions[:, 1], directions[:, 0])
    elevation_rad = np.arctan2(directions[:, 2], np.linalg.norm(directions[:, :2], axis=1))
    start_rad, gap_rad = _widest_gap(azimuth_rad)
    if gap_rad < _LARGEST_GAP_RAD:
        circle = np.arange(0.0, 2.0 * np.pi + _STEP_RAD, _STEP_RAD)
        outlines = [np.column_stack([circle, np.full_like(circle, end)]) for end in _ends(elevation_rad)]
        corners = np.concatenate([outline[:: len(outline) // 4][:4] for outline in outlines])
    else:
        try:
            corners = _corners(np.column_stack([(azimuth_rad - start_rad) % (2.0 * np.pi), elevation_rad]))
        except QhullError:
            return ()
        corners[:, 0] += start_rad
        outlines = [_densely(corners)]
    rays = corners[:: max(1, -(-len(corners) // _MAX_RAYS))]
    tips_m = _on_sphere(rays, radius_m)
    strips = [*(_on_sphere(outline, radius_m) for outline in outlines), *np.stack([0.0 * tips_m, tips_m], axis=1)]
    return tuple(strips)


def _widest_gap(azimuth_rad: FloatArray) -> tuple[float, float]:
    """Where the widest gap between azimuths ends, and how wide it is."""
    ordered = np.sort(azimuth_rad)
    gaps = np.diff(ordered, append=ordered[0] + 2.0 * np.pi)
    widest = int(np.argmax(gaps))
    return float(ordered[(widest + 1) % len(ordered)]), float(gaps[widest])


def _ends(elevation_rad: FloatArray) -> tuple[float, float]:
    return float(elevation_rad.min()), float(elevation_rad.max())


def _corners(angles_rad: FloatArray) -> FloatArray:
    return np.asarray(angles_rad[ConvexHull(angles_rad).vertices])


def _densely(corners: FloatArray) -> FloatArray:
    """The closed outline with enough points in between to follow the sphere."""
    pieces = []
    for start, end in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        count = max(1, int(np.ceil(np.abs(end - start).max() / _STEP_RAD)))
        pieces.append(np.linspace(start, end, count, endpoint=False))
    return np.concatenate([*pieces, corners[:1]])


def _on_sphere(angles_rad: FloatArray, radius_m: float) -> FloatArray:
    azimuth, elevation = angles_rad.T
    return radius_m * np.column_stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
