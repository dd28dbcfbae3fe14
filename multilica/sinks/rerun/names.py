# SPDX-License-Identifier: Apache-2.0
"""Places of the names in a view, at which they do not touch each other."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from multilica.geometry import FloatArray, RigidTransform
from multilica.sinks.rerun.scene import lidar_path
from multilica.sinks.rerun.views import Overrides

# The viewer's own: its angle of view, and the boxes of labels below their points.
_HALF_VIEW_RAD = float(np.deg2rad(55.0 / 2.0))
_CHARACTER_PX, _PADDING_PX, _LABEL_PX, _BELOW_PX = 7.5, 14.0, 28.0, 2.0
_ORIGIN_PX = 6.0
_LENGTHS_PX = (*range(40, 100, 10), *range(100, 400, 20))
_TURNS_RAD = tuple(np.deg2rad(turn) for turn in (0, 15, -15, 30, -30, 45, -45, 60, -60, 90, -90, 120, -120, 180))


class _Box(NamedTuple):
    """The sides of a label in pixels, right of and below the middle of the view."""

    left: float
    top: float
    right: float
    bottom: float

    def touches(self, other: _Box) -> bool:
        across = self.left < other.right and other.left < self.right
        return across and self.top < other.bottom and other.top < self.bottom

    def is_in(self, size_px: tuple[float, float]) -> bool:
        half_width, half_height = size_px[0] / 2.0, size_px[1] / 2.0
        return max(-self.left, self.right) < half_width and max(-self.top, self.bottom) < half_height


def names_apart(
    labels: Mapping[str, str],
    poses: Mapping[str, RigidTransform],
    eye: rrb.EyeControls3D,
    size_px: tuple[float, float],
) -> Overrides:
    """Return lines from LiDARs to their names, which lie around the rig and do not touch.

    Args:
        labels: text beside each LiDAR.
        poses: ``T_frame_lidar`` in the frame of the view.
        size_px: width and height of the view; in a larger one the names are farther apart.
    """
    overrides: Overrides = {}
    if not poses:
        return overrides
    seen_px, metres_per_px, axes = _seen([pose.xyz_m for pose in poses.values()], eye, size_px[1])
    taken = [_Box(x - _ORIGIN_PX, y - _ORIGIN_PX, x + _ORIGIN_PX, y + _ORIGIN_PX) for x, y in seen_px]
    middle_px = np.mean(seen_px, axis=0)
    for lidar, origin_px, per_px in zip(poses, seen_px, metres_per_px, strict=True):
        offset_px = _free_offset_px(origin_px, middle_px, labels[lidar], taken, size_px)
        tip_m = poses[lidar].rotation.T @ (per_px * offset_px @ axes)
        strip = np.array([[np.zeros(3), tip_m]], dtype=np.float32)
        overrides[lidar_path(lidar, "name")] = rr.LineStrips3D.from_fields(strips=strip)
        overrides[lidar_path(lidar, "name", "tip")] = rr.Points3D.from_fields(positions=strip[0, 1:])
    return overrides


def _free_offset_px(
    origin_px: FloatArray, middle_px: FloatArray, label: str, taken: list[_Box], size_px: tuple[float, float]
) -> FloatArray:
    """Return the shortest way (2,) to a free place for a label, outwards if possible, and take that place."""
    outwards = origin_px - middle_px
    angle_rad = float(np.arctan2(outwards[1], outwards[0])) if np.linalg.norm(outwards) > 1.0 else -np.pi / 2.0
    for length_px, turn_rad in product(_LENGTHS_PX, _TURNS_RAD):
        offset_px = length_px * np.array([np.cos(angle_rad + turn_rad), np.sin(angle_rad + turn_rad)])
        box = _label_box(origin_px + offset_px, label)
        if box.is_in(size_px) and not any(box.touches(other) for other in taken):
            break
    taken.append(box)
    return np.asarray(offset_px)


def _label_box(tip_px: FloatArray, label: str) -> _Box:
    half_px = (_PADDING_PX + _CHARACTER_PX * len(label)) / 2.0
    x, y = (float(value) for value in tip_px)
    return _Box(x - half_px, y - _BELOW_PX, x + half_px, y + _BELOW_PX + _LABEL_PX)


def _seen(
    points_m: Sequence[FloatArray], eye: rrb.EyeControls3D, height_px: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return where points are seen, in pixels right of and below the middle of the view.

    Returns:
        (N, 2) pixels, (N,) metres per pixel at the points, (2, 3) unit vectors to the right and down.
    """
    position, target, up = map(_vector, (eye.position, eye.look_target, eye.eye_up))
    ahead = (target - position) / np.linalg.norm(target - position)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(ahead, right)])
    towards_m = np.array(points_m) - position
    metres_per_px = np.maximum(towards_m @ ahead, 0.1) * np.tan(_HALF_VIEW_RAD) / (height_px / 2.0)
    return towards_m @ axes.T / metres_per_px[:, None], metres_per_px, axes


def _vector(batch: Any) -> FloatArray:  # noqa: ANN401 - types of Rerun without a common one
    return np.array(batch.as_arrow_array().to_pylist()[0])
