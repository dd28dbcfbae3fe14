# SPDX-License-Identifier: Apache-2.0
"""Drawings of the rig: its clouds in 3-D, and the standard deviation of each pose."""

import base64
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results import LEVEL_FRAME
from multilica.sinks.drawing import SIGMAS, every_nth, sample_points
from multilica.sinks.report.contents import ReportContents

MAX_POINTS = 300_000
"""More make the view slow on machines without a graphics card."""

BYTES_PER_POINT = 8
"""Three coordinates of two bytes each, as base64."""

FIRST_VIEW_RAD = (-1.9, 0.7)
"""Direction from which the view shows the clouds first: angle about z, and above the horizon."""

QUARTER_TURN = RigidTransform.from_xyz_rpy("view", LEVEL_FRAME, (0.0, 0.0, 0.0), (0.0, 0.0, np.pi / 2.0))
"""From x to the right, y up to x up, y to the left."""
_STEPS = 65_535
_REACH_M = 40.0
_ENOUGH_POINTS = 10_000
_WIDTH_PX, _LEAST_HEIGHT_PX = 560.0, 240.0
_SIDE_PX = 190.0
"""Width of each column of labels."""
_GAP_PX = 53.0
"""Between the rig and the labels: fans and ellipses end there."""
_MARGIN_PX = 78.0
_LABEL_PX = 58.0
_LARGEST_ELLIPSE_PX = 70.0
_LARGEST_FAN_RAD = math.radians(35.0)
_FAN_PX = 48.0
_LEAST_SPAN_M = 0.5
_LEAST_ELLIPSE_M = 1e-9
_LEVEL_AXIS = 0.5
_FACTORS = tuple(step * 10**power for power in (4, 3, 2, 1, 0) for step in (5, 2, 1))
_TOP, _SIDE = (0, 1), (0, 2)
_ALONG = ("From above: x to the right, y up.", "From the right: x to the right, z up.")
_ACROSS = ("From above: x up, y to the left.", "From behind: y to the left, z up.")


def rig_scene(contents: ReportContents, max_points: int) -> dict[str, Any]:
    """Return the data of the view's script, JSON-ready.

    Args:
        max_points: over all clouds; each is thinned at random to its share.

    Returns:
        Per LiDAR its points, quantised to 16 bits within its cloud's extent, and its placed or refused pose; matrices
        are in column-major order.
    """
    clouds = {name: cloud for name, cloud in contents.clouds.items() if len(cloud)}
    share = max_points // max(1, len(clouds))
    placed, level, colours = contents.document.poses, contents.shown_level, contents.colours
    posed = refused_poses(contents) | placed
    recorded = {name: RigidTransform.identity(contents.target, name) for name in contents.document.lidars}
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
                "pose": _columns((level @ posed[name]).matrix) if name in posed else None,
                **_quantised(sample_points(cloud, share).astype(np.float64)),
            }
            for name, cloud in clouds.items()
        ],
    }


def refused_poses(contents: ReportContents) -> dict[str, RigidTransform]:
    """Return the best refused pose of each unplaced LiDAR relative to those with a pose."""
    placed = contents.document.poses
    poses: dict[str, RigidTransform] = {}
    for pair in sorted(contents.document.pairs, key=lambda pair: pair.evidence, reverse=True):
        for pose in (pair.pose, pair.pose.inverse()):
            if pose.target in placed and pose.source not in placed:
                poses.setdefault(pose.source, placed[pose.target] @ pose)
    return poses


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


class SigmaMark(NamedTuple):
    """A LiDAR in a view, in pixels to the right and down.

    Args:
        forward: end of the line along the axis that the fan is about.
        ellipse: half axes in pixels, then the angle of the first one in degrees; None without a covariance.
        fan: SVG path of the sector of the rotation; empty without a covariance.
        label: where its text begins.
        anchor: `start` or `end`, as SVG aligns texts.
    """

    name: str
    at: tuple[float, float]
    forward: tuple[float, float]
    ellipse: tuple[float, float, float] | None
    fan: str
    label: tuple[float, float]
    anchor: str


class SigmaView(NamedTuple):
    """The rig along one axis."""

    name: str
    caption: str
    size_px: tuple[float, float]
    marks: tuple[SigmaMark, ...]


class RigDrawing(NamedTuple):
    """The views of a rig; ellipses and fans show `sigmas` standard deviations, `enlarged` and `turned` times."""

    views: tuple[SigmaView, ...]
    sigmas: float
    enlarged: int
    turned: int


class _Pose(NamedTuple):
    """A LiDAR's pose in the level frame; the covariances (3, 3) are along its axes."""

    pose: RigidTransform
    position: FloatArray | None = None
    rotation: FloatArray | None = None


def rig_drawing(contents: ReportContents) -> RigDrawing | None:
    """Lay out the rig from above and from the side; None if no LiDAR has a covariance."""
    if all(contents.document.lidars[name].covariance is None for name in contents.document.poses):
        return None
    level = contents.shown_level
    placed_m = np.array([(level @ pose).xyz_m for pose in contents.document.poses.values()])
    is_wide = bool(np.ptp(placed_m[:, 1]) > np.ptp(placed_m[:, 0]))
    poses = [_levelled(contents, name, QUARTER_TURN @ level if is_wide else level) for name in contents.document.poses]
    xyz_m = np.array([each.pose.xyz_m for each in poses])
    spans_m = np.maximum(np.ptp(xyz_m, axis=0), _LEAST_SPAN_M)
    scale = (_WIDTH_PX - 2.0 * _SIDE_PX) / float(spans_m[0])
    scale = min(scale, 3.0 * _LEAST_HEIGHT_PX / float(spans_m[1:].max()))
    largest_m = _largest([each.position for each in poses])
    scale = min(scale, _LARGEST_ELLIPSE_PX / max(largest_m, _LEAST_ELLIPSE_M))
    enlarged = _factor(scale * largest_m, _LARGEST_ELLIPSE_PX)
    turned = _factor(_largest([each.rotation for each in poses]), _LARGEST_FAN_RAD)
    names = zip(("top", "side"), (_TOP, _SIDE), _ACROSS if is_wide else _ALONG, strict=True)
    views = tuple(_view(view, poses, xyz_m, scale, enlarged, turned) for view in names)
    return RigDrawing(views, SIGMAS, enlarged, turned)


def _levelled(contents: ReportContents, name: str, level: RigidTransform) -> _Pose:
    pose = level @ contents.document.poses[name]
    covariance = contents.document.lidars[name].covariance
    if covariance is None or name == contents.target:
        return _Pose(pose)
    turn, matrix = level.rotation, np.asarray(covariance)
    return _Pose(pose, turn @ matrix[3:, 3:] @ turn.T, turn @ matrix[:3, :3] @ turn.T)


def _largest(covariances: Sequence[FloatArray | None]) -> float:
    """Return the largest half axis that is drawn of any covariance."""
    known = [each for each in covariances if each is not None]
    return SIGMAS * math.sqrt(max(float(np.linalg.eigvalsh(each)[-1]) for each in known))


def _factor(size: float, limit: float) -> int:
    """Return the largest enlargement that keeps a size below the limit; 1 if none does."""
    return next((factor for factor in _FACTORS if factor * size <= limit), 1)


def _view(
    view: tuple[str, tuple[int, int], str],
    poses: Sequence[_Pose],
    xyz_m: FloatArray,
    scale: float,
    enlarged: int,
    turned: int,
) -> SigmaView:
    name, axes, caption = view
    rows = math.ceil(len(poses) / 2.0)
    height = max(
        _LEAST_HEIGHT_PX, scale * float(np.ptp(xyz_m[:, axes[1]])) + 2.0 * _MARGIN_PX, (rows + 0.5) * _LABEL_PX
    )
    middle_m = (xyz_m.min(axis=0) + xyz_m.max(axis=0)) / 2.0
    offsets = scale * (xyz_m - middle_m)[:, axes] * (1.0, -1.0)
    places = offsets + np.array([_WIDTH_PX / 2.0, height / 2.0])
    labels = _label_places(places, height)
    marks = tuple(
        _mark(pose, axes, places[index], labels[index], scale * enlarged, turned) for index, pose in enumerate(poses)
    )
    return SigmaView(name, caption, (_WIDTH_PX, round(height, 1)), marks)


def _label_places(places: FloatArray, height: float) -> dict[int, tuple[float, float, str]]:
    """Return places of texts in a column on each side, in order of height, so that none covers another."""
    by_x = np.lexsort((places[:, 1].round(3), places[:, 0].round(3)))
    half = len(by_x) // 2
    labels: dict[int, tuple[float, float, str]] = {}
    for column, x, anchor in (
        (by_x[:half], _SIDE_PX - _GAP_PX, "end"),
        (by_x[half:], _WIDTH_PX - _SIDE_PX + _GAP_PX, "start"),
    ):
        order = sorted(column.tolist(), key=lambda index: (round(float(places[index, 1]), 3), index))
        wanted = [float(places[index, 1]) for index in order]
        for index, y in zip(order, _spread(wanted, height), strict=True):
            labels[index] = (x, y, anchor)
    return labels


def _spread(wanted: Sequence[float], height: float) -> list[float]:
    """Move heights in order apart by the height of a label, within the picture."""
    found = list(wanted)
    top, bottom = _LABEL_PX / 2.0, height - _LABEL_PX / 2.0
    for index in range(len(found)):
        least = top if index == 0 else found[index - 1] + _LABEL_PX
        found[index] = max(found[index], least)
    for index in reversed(range(len(found))):
        most = bottom if index == len(found) - 1 else found[index + 1] - _LABEL_PX
        found[index] = min(found[index], most)
    return found


def _mark(
    each: _Pose,
    axes: tuple[int, int],
    at: FloatArray,
    label: tuple[float, float, str],
    pixels_per_m: float,
    turned: int,
) -> SigmaMark:
    direction = _forward(each.pose, axes)
    ellipse, fan = None, ""
    if each.position is not None and each.rotation is not None:
        variances, vectors = np.linalg.eigh(each.position[np.ix_(axes, axes)])
        half_axes = SIGMAS * pixels_per_m * np.sqrt(np.maximum(variances, 0.0))
        angle = math.degrees(math.atan2(-vectors[1, 1], vectors[0, 1]))
        ellipse = (round(float(half_axes[1]), 2), round(float(half_axes[0]), 2), round(angle, 1))
        normal = 3 - sum(axes)
        half_rad = turned * SIGMAS * math.sqrt(max(float(each.rotation[normal, normal]), 0.0))
        fan = _sector(at, direction, half_rad)
    x, y, anchor = label
    tip = _rounded(at + _on_fan(direction))
    return SigmaMark(each.pose.source, _rounded(at), tip, ellipse, fan, (round(x, 1), round(y, 1)), anchor)


def _forward(pose: RigidTransform, axes: tuple[int, int]) -> float:
    """Return the angle of the first axis of the LiDAR that is seen from its side, clockwise from the right."""
    seen = pose.rotation[list(axes), :]
    lengths = np.linalg.norm(seen, axis=0)
    axis = next(index for index in range(3) if lengths[index] >= _LEVEL_AXIS)
    return math.atan2(-float(seen[1, axis]), float(seen[0, axis]))


def _sector(at: FloatArray, direction: float, half_rad: float) -> str:
    """Return the SVG path of a sector around a direction."""
    ends = (_rounded(at + _on_fan(angle)) for angle in (direction - half_rad, direction + half_rad))
    (x, y), (ax, ay), (bx, by) = _rounded(at), *ends
    return f"M{x} {y}L{ax} {ay}A{_FAN_PX:g} {_FAN_PX:g} 0 0 1 {bx} {by}Z"


def _on_fan(angle: float) -> FloatArray:
    return _FAN_PX * np.array([math.cos(angle), math.sin(angle)])


def _rounded(point: FloatArray) -> tuple[float, float]:
    return round(float(point[0]), 1), round(float(point[1]), 1)
