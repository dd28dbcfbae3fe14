# SPDX-License-Identifier: Apache-2.0
"""Data of the 3-D view of a report."""

import base64
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.sinks.drawing.palette import Rgb
from multilica.sinks.drawing.shapes import every_nth, sample_points
from multilica.sinks.report.contents import ReportContents

MAX_POINTS = 300_000
"""More make the view slow on machines without a graphics card."""

BYTES_PER_POINT = 8
"""Three coordinates of two bytes each, as base64."""

FIRST_VIEW_RAD = (-1.9, 0.7)
"""Direction from which the view shows the clouds first: angle about z, and above the horizon."""

_STEPS = 65_535
_REACH_M = 40.0
_ENOUGH_POINTS = 10_000


def rig_scene(
    contents: ReportContents, level: RigidTransform, colours: Mapping[str, Rgb], max_points: int
) -> dict[str, Any]:
    """Return the data of the view's script, JSON-ready.

    Args:
        level: the target LiDAR's pose in the frame of the view, z up.
        max_points: over all clouds; each is thinned at random to its share.

    Returns:
        Per LiDAR its points, quantised to 16 bits within its cloud's extent, and its placed or refused pose; matrices
        are in column-major order.
    """
    clouds = {name: cloud for name, cloud in contents.clouds.items() if len(cloud)}
    share = max_points // max(1, len(clouds))
    placed, refused = contents.poses, refused_poses(contents)
    recorded = {name: RigidTransform.identity(contents.target, name) for name in contents.names}
    seen_first = {name: pose for name, pose in (placed or recorded).items() if name in clouds}
    return {
        "level": _columns(level.matrix),
        "direction": FIRST_VIEW_RAD,
        **_camera([(level @ pose).apply(every_nth(clouds[name], _ENOUGH_POINTS)) for name, pose in seen_first.items()]),
        "clouds": [
            {
                "name": name,
                "colour": [round(channel / 255.0, 4) for channel in colours[name]],
                "placed": name in placed,
                "pose": _pose(level, placed.get(name) or refused.get(name)),
                **_quantised(sample_points(cloud, share).astype(np.float64)),
            }
            for name, cloud in clouds.items()
        ],
    }


def refused_poses(contents: ReportContents) -> dict[str, RigidTransform]:
    """Return the best refused pose of each unplaced LiDAR relative to those with a pose."""
    placed = contents.poses
    poses: dict[str, RigidTransform] = {}
    for pair in sorted(contents.document.pairs, key=lambda pair: pair.evidence, reverse=True):
        for pose in (pair.pose, pair.pose.inverse()):
            if pose.target in placed and pose.source not in placed:
                poses.setdefault(pose.source, placed[pose.target] @ pose)
    return poses


def _pose(level: RigidTransform, pose: RigidTransform | None) -> list[float] | None:
    return None if pose is None else _columns((level @ pose).matrix)


def _columns(matrix: FloatArray) -> list[float]:
    return [round(float(value), 7) for value in matrix.T.reshape(-1)]


def _camera(clouds: Sequence[FloatArray]) -> dict[str, Any]:
    """Return a camera that shows most of the placed clouds."""
    points_m = np.concatenate([np.zeros((1, 3)), *clouds])
    low, middle, high = np.quantile(points_m, (0.1, 0.5, 0.9), axis=0)
    centre = (*np.clip(middle[:2], -_REACH_M, _REACH_M), 0.0)
    size_m = float(np.clip(np.linalg.norm((high - low)[:2]), 8.0, 2.0 * _REACH_M))
    return {"centre": [round(float(value), 2) for value in centre], "distance": round(1.1 * size_m, 2)}


def _quantised(points_m: FloatArray) -> dict[str, Any]:
    if len(points_m) == 0:
        return {"count": 0, "low": [0.0] * 3, "span": [1.0] * 3, "points": ""}
    low = points_m.min(axis=0)
    span = np.maximum(points_m.max(axis=0) - low, 1e-3)
    steps = np.rint((points_m - low) / span * _STEPS).astype("<u2")
    return {
        "count": len(points_m),
        "low": [round(float(value), 4) for value in low],
        "span": [round(float(value), 4) for value in span],
        "points": base64.b64encode(steps.tobytes()).decode("ascii"),
    }
