# SPDX-License-Identifier: Apache-2.0
"""Colours, samples and shapes that the sinks share; colours are distinct for any colour vision on a dark background."""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

from multilica.geometry import Z_AXIS, Float32Array, FloatArray, RigidTransform, fixed_sign, largest_index, turn_upwards
from multilica.results import BoolArray, Correspondences, Hypothesis, PairKey
from multilica.results.document import ResultDocument
from multilica.sinks.run_state import RunState
from multilica.snapshot import LidarScans

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

_RADIUS_SAMPLE = 10_000
EDGE_LABEL_SHARE = 0.4
"""Position of labels along the edges of graphs; off the middle, where the diagonals of a square meet."""
SIGMAS = 3.0
"""Half axes, in standard deviations."""
_ELLIPSOID_SCALES = (50.0, 20.0, 10.0, 5.0, 2.0, 1.0)
_LARGEST_ELLIPSOID_M = 1.0
_RADIUS_M = 2.0
_LARGEST_GAP_RAD = float(np.deg2rad(20.0))
_STEP_RAD = float(np.deg2rad(3.0))
_MAX_RAYS = 8
_ENOUGH_RETURNS = 20_000


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


def sample_indices(count: int, limit: int) -> npt.NDArray[np.int64]:
    """Return at most `limit` random indices below `count`, in order; the same on every call."""
    if count <= limit:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, size=limit, replace=False))


def every_nth(points_m: npt.NDArray[np.floating], enough: int) -> npt.NDArray[np.floating]:
    """Return at least `enough` of the points (N, 3), evenly spaced in order, as a view."""
    return points_m[:: _step(len(points_m), enough)]


def _step(count: int, enough: int) -> int:
    return max(1, count // enough)


def sample_points(points_m: npt.NDArray[np.floating], limit: int) -> Float32Array:
    """Return at most `limit` of the points (N, 3), as float32."""
    shown_m = points_m if len(points_m) <= limit else points_m[sample_indices(len(points_m), limit)]
    return np.asarray(shown_m, dtype=np.float32)


def sample_returns(lidar: LidarScans, limit: int) -> Float32Array:
    """Return at most `limit` of a LiDAR's returns (N, 3) over all frames."""
    return lidar.returns_at(sample_indices(lidar.points_count, limit))


def slot_offsets_m(state: RunState) -> dict[str, float]:
    """Return cached offsets along y at which the dense parts of the raw clouds do not overlap."""
    if state.snapshot is None or state.slots_m:
        return state.slots_m
    edge_m = 0.0
    for lidar in state.snapshot.lidars:
        radius_m = shown_radius_m(
            lidar.returns_at(np.arange(0, lidar.points_count, _step(lidar.points_count, _RADIUS_SAMPLE)))
        )
        state.slots_m[lidar.name] = edge_m - radius_m
        edge_m -= 2.0 * radius_m
    return state.slots_m


def shown_radius_m(points_m: npt.NDArray[np.floating]) -> float:
    """Return the radius around the sensor that contains most of a cloud (N, 3)."""
    sample_m = every_nth(points_m, _RADIUS_SAMPLE)
    finite = sample_m[np.all(np.isfinite(sample_m), axis=1)]
    if len(finite) == 0:
        return 5.0
    return float(np.clip(np.percentile(np.linalg.norm(finite[:, :2], axis=1), 75.0), 5.0, 40.0))


class Lines(NamedTuple):
    """Segments (K, 2, 3) in metres."""

    segments_m: FloatArray
    colour: Rgb


class Ellipsoid(NamedTuple):
    """Half axes (3,) in metres along the axes of a pose."""

    pose: RigidTransform
    half_sizes_m: FloatArray
    colour: Rgb


class Label(NamedTuple):
    """Text that faces the camera."""

    xyz_m: FloatArray
    text: str
    colour: Rgb


class Drawing(NamedTuple):
    """Primitives in one frame; `name` is unique in a topic."""

    name: str
    frame_id: str
    lines: tuple[Lines, ...] = ()
    ellipsoids: tuple[Ellipsoid, ...] = ()
    labels: tuple[Label, ...] = ()


def kept_matches(state: RunState, matches: Correspondences, hypothesis: Hypothesis) -> BoolArray:
    """Return which matches (M,) agree with the hypothesis, by distance if the solver does not say."""
    if len(hypothesis.inliers) == len(matches) and hypothesis.inliers.any():
        return hypothesis.inliers
    bound_m = state.config.coarse.noise_bound_m if state.config is not None else 0.0
    moved_m = hypothesis.T_target_source.apply(matches.source_points_m)
    return np.asarray(np.linalg.norm(moved_m - matches.target_points_m, axis=1) <= bound_m)


def kept_count(state: RunState, pair: PairKey) -> int:
    """Return how many matches of a pair agree with its best hypothesis; none without one."""
    coarse = state.coarse.get(pair)
    if coarse is None or not coarse.hypotheses or pair not in state.matches:
        return 0
    return int(kept_matches(state, state.matches[pair], coarse.hypotheses[0]).sum())


def match_lines(matches: Correspondences, chosen: BoolArray, pose: RigidTransform, limit: int) -> FloatArray:
    """Return lines (K, 2, 3) of at most `limit` chosen matches, from target points to source points at a pose."""
    rows = np.flatnonzero(chosen)
    rows = rows[sample_indices(len(rows), limit)]
    return np.stack([matches.target_points_m[rows], pose.apply(matches.source_points_m[rows])], axis=1)


def uncertainty_ellipsoid(document: ResultDocument, lidar: str) -> tuple[FloatArray, RigidTransform] | None:
    """Return half axes (3,) in metres, true to size, with the ellipsoid's pose; None without a covariance."""
    pose, covariance = document.pose(lidar), document.lidars[lidar].covariance
    if covariance is None or pose is None:
        return None
    variances, axes = np.linalg.eigh(np.asarray(covariance)[3:, 3:])
    axes = np.apply_along_axis(fixed_sign, 0, axes)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    half_sizes_m = SIGMAS * np.sqrt(np.maximum(variances, 0.0))
    return half_sizes_m, RigidTransform.from_rotation_translation(pose.target, pose.source, axes, pose.xyz_m)


def ellipsoid_scale(document: ResultDocument) -> float:
    """Return how many times the ellipsoids of a result are enlarged.

    Millimetres would be invisible, metres would hide the rig: it is the largest of a few factors, one for all LiDARs,
    that keeps every half axis below 1 m, and 1 if none does.
    """
    found = (uncertainty_ellipsoid(document, lidar) for lidar in document.lidars)
    largest_m = max((float(each[0].max()) for each in found if each is not None), default=0.0)
    return next((scale for scale in _ELLIPSOID_SCALES if scale * largest_m <= _LARGEST_ELLIPSOID_M), 1.0)


def ellipsoid_label(document: ResultDocument, lidar: str, scale: float) -> str:
    """Return the label of an uncertain LiDAR's ellipsoid; empty for any other LiDAR."""
    uncertain = document.lidars[lidar].status == "uncertain"
    return f"{lidar}: uncertain ({SIGMAS:g} sigma x {scale:g})" if uncertain else ""


def shown_field_of_view(state: RunState, lidar: str) -> tuple[FloatArray, ...]:
    """Return the cached field of view of a LiDAR whose cloud is preprocessed."""
    if lidar not in state.outlines:
        cloud = state.clouds[lidar]
        state.outlines[lidar] = field_of_view(cloud.returns_m, cloud.elevation_axis)
    return state.outlines[lidar]


def field_of_view(
    returns_m: Float32Array, elevation_axis: FloatArray = Z_AXIS, radius_m: float = _RADIUS_M
) -> tuple[FloatArray, ...]:
    """Return the convex outline, in azimuth and elevation, of a LiDAR's returns.

    A LiDAR that sees all around, with no gap of 20 degrees, gets a circle at its lowest and its highest elevation.

    Args:
        returns_m: (N, 3) in the sensor's own frame.
        elevation_axis: (3,) about which its beams turn.
        radius_m: distance at which the outline is drawn.

    Returns:
        Polylines (K, 3): the outline or both circles, then rays from the sensor; none if the returns span no area.
    """
    directions = every_nth(returns_m, _ENOUGH_RETURNS).astype(np.float64)
    directions = directions[np.linalg.norm(directions, axis=1) > 0.0]
    if len(directions) < 3:
        return ()
    upwards = turn_upwards(elevation_axis)
    directions = directions @ upwards.T
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
    return tuple(strip @ upwards for strip in strips)


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
