# SPDX-License-Identifier: Apache-2.0
"""Outline of a LiDAR's field of view."""

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from multilica.geometry import FloatArray, largest_index
from multilica.sinks.run_state import RunState

__all__ = ["field_of_view", "shown_field_of_view"]

_RADIUS_M = 2.0
_LARGEST_GAP_RAD = float(np.deg2rad(20.0))
_STEP_RAD = float(np.deg2rad(3.0))
_MAX_RAYS = 8
_MAX_RETURNS = 20_000


def shown_field_of_view(state: RunState, lidar: str) -> tuple[FloatArray, ...]:
    """Return the cached field of view of a LiDAR whose cloud is preprocessed."""
    if lidar not in state.outlines:
        state.outlines[lidar] = field_of_view(state.clouds[lidar].returns_m)
    return state.outlines[lidar]


def field_of_view(returns_m: FloatArray, radius_m: float = _RADIUS_M) -> tuple[FloatArray, ...]:
    """Return the convex outline, in azimuth and elevation, of a LiDAR's returns.

    A LiDAR that sees all around, with no gap of 20 degrees, gets a circle at its lowest and its highest elevation.

    Args:
        returns_m: (N, 3) in the sensor's own frame.
        radius_m: distance at which the outline is drawn.

    Returns:
        Polylines (K, 3): the outline or both circles, then rays from the sensor; none if the returns span no area.
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
        outlines = [
            np.column_stack([circle, np.full_like(circle, end)]) for end in (elevation_rad.min(), elevation_rad.max())
        ]
        corners = np.concatenate([outline[:: len(outline) // 4][:4] for outline in outlines])
    else:
        try:
            angles_rad = np.column_stack([(azimuth_rad - start_rad) % (2.0 * np.pi), elevation_rad])
            corners = angles_rad[ConvexHull(angles_rad).vertices]
        except QhullError:
            return ()
        corners[:, 0] += start_rad
        outlines = [_densely(corners)]
    rays = corners[:: max(1, -(-len(corners) // _MAX_RAYS))]
    tips_m = _on_sphere(rays, radius_m)
    strips = [*(_on_sphere(outline, radius_m) for outline in outlines), *np.stack([0.0 * tips_m, tips_m], axis=1)]
    return tuple(strips)


def _widest_gap(azimuth_rad: FloatArray) -> tuple[float, float]:
    """Return the end and the width of the widest gap between azimuths."""
    ordered = np.sort(azimuth_rad)
    gaps = np.diff(ordered, append=ordered[0] + 2.0 * np.pi)
    widest = largest_index(gaps)
    return float(ordered[(widest + 1) % len(ordered)]), float(gaps[widest])


def _densely(corners: FloatArray) -> FloatArray:
    """Close the outline; add points in between to follow the sphere."""
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
