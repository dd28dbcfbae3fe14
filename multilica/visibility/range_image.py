# SPDX-License-Identifier: Apache-2.0
"""Range image of one sensor: surface where its beams returned, empty space before it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import Delaunay, cKDTree

from multilica.geometry import FloatArray, largest_index
from multilica.results import BeamLabel

__all__ = ["RangeImage", "build_range_image", "label_points"]

LabelArray = npt.NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class RangeImage:
    """Triangles between neighbouring beams of one sensor, whatever its scan pattern.

    The Delaunay triangulation of beam directions is a range image whose pixels are as large as the sensor's own
    beam spacing: rings, grids and rosettes come out alike.

    Args:
        to_pole: (3, 3) rotation that takes the emptiest direction to -z, from where directions are projected.
        triangulation: of the stereographic projection of the beams; circles stay circles, so it is Delaunay on the
            sphere.
        planes: (T, 3) per triangle the vector c with ``c @ p == 1`` on the plane through its three returns.
        nearest_m: (T,) smallest range of the three returns.
        usable: (T,) the three beams are neighbours.
        smooth: (T,) the three returns can lie on one surface.
        gap_rad: (T,) longest edge where it is the sensor's own gap between two beams; 0 where beams between were left
            out to bound the size.
    """

    to_pole: FloatArray
    triangulation: Any
    planes: FloatArray
    nearest_m: FloatArray
    usable: npt.NDArray[np.bool_]
    smooth: npt.NDArray[np.bool_]
    gap_rad: FloatArray


# Bounds on time: the triangulation of 12,000 beams takes about 0.1 s.
_MAX_RETURNS = 200_000
_MAX_BEAMS = 12_000
# The finest beam spacing of vehicle LiDARs is about 0.1 deg; two beams then share a cell.
_FINEST_CELL_RAD = 0.004
_CELL_GROWTH = 1.4
# Beams farther apart than this, in usual spacings or in degrees, are no neighbours: a hole lies between them.
_EDGE_FACTOR = 3.0
_MAX_EDGE_RAD = np.deg2rad(8.0)
# A gap wider than two cells and a half is one of the sensor, not of the selection by cells.
_GAP_FACTOR = 2.5
# At less than 3 deg of incidence, three returns rather span an edge between two surfaces.
_MIN_INCIDENCE = 0.05
_POLE_DIRECTIONS = 400


def build_range_image(returns_m: FloatArray) -> RangeImage | None:
    """Triangulate the beams of one sensor.

    Args:
        returns_m: (N, 3) returns in the sensor's own frame, the sensor at the origin.

    Returns:
        None if there are too few beams to span a triangle.
    """
    stride = max(1, len(returns_m) // _MAX_RETURNS)
    beams_m, cell_rad = _one_per_cell(returns_m[::stride])
    if len(beams_m) < 4:
        return None
    range_m = np.linalg.norm(beams_m, axis=1)
    directions = beams_m / range_m[:, None]
    to_pole = _rotation_to_pole(directions)
    triangulation = Delaunay(_stereographic(directions @ to_pole.T))
    corners = triangulation.simplices
    longest_rad = _longest_edge_rad(directions[corners])
    spacing_rad = float(np.median(longest_rad))
    points = beams_m[corners]
    with np.errstate(all="ignore"):
        planes = _planes(points)
    incidence = 1.0 / (np.linalg.norm(planes, axis=1) * range_m[corners].mean(axis=1))
    return RangeImage(
        to_pole=to_pole,
        triangulation=triangulation,
        planes=planes,
        nearest_m=range_m[corners].min(axis=1),
        usable=longest_rad <= min(_EDGE_FACTOR * spacing_rad, _MAX_EDGE_RAD),
        smooth=incidence >= _MIN_INCIDENCE,
        gap_rad=np.where(longest_rad > _GAP_FACTOR * cell_rad, longest_rad, 0.0),
    )


def label_points(
    image: RangeImage,
    points_m: FloatArray,
    tolerance_m: float,
    tolerance_rad: float,
    widths_m: FloatArray | None = None,
) -> LabelArray:
    """Label points (N, 3), given in the image's sensor frame.

    Args:
        tolerance_m: how far from a plane a point still lies on it, at range 0.
        tolerance_rad: by how much that grows with range: the error of the rotation.
        widths_m: (N,) width of the object that each point lies on: one narrower than the gap between beams violates
            nothing. None: no object is narrow.
    """
    range_m = np.maximum(np.linalg.norm(points_m, axis=1), 1e-9)
    directions = points_m / range_m[:, None]
    triangle = image.triangulation.find_simplex(_stereographic(directions @ image.to_pole.T))
    seen = (triangle >= 0) & image.usable[triangle]
    plane = image.planes[triangle]
    beyond_m = (np.einsum("ij,ij->i", plane, points_m) - 1.0) / np.linalg.norm(plane, axis=1)
    tolerance = tolerance_m + tolerance_rad * range_m
    agree = image.smooth[triangle] & (np.abs(beyond_m) <= tolerance)
    before = range_m < image.nearest_m[triangle] - 2.0 * tolerance
    violate = before & ((beyond_m < -2.0 * tolerance) | ~image.smooth[triangle])
    if widths_m is not None:
        violate &= image.gap_rad[triangle] * range_m <= widths_m
    labels = np.full(len(points_m), BeamLabel.OCCLUDED, dtype=np.uint8)
    labels[violate] = BeamLabel.VIOLATE
    labels[agree] = BeamLabel.AGREE
    labels[~seen] = BeamLabel.UNSEEN
    return labels


def _one_per_cell(returns_m: FloatArray) -> tuple[FloatArray, float]:
    """Select the return of median range per cell of directions; enlarge the cells until there are few enough.

    The number of cells falls at most with the square of their size, often slower: a ring has one row of them.

    Returns:
        The selected returns (M, 3) with the size of the cells.
    """
    range_m = np.linalg.norm(returns_m, axis=1)
    returns_m, range_m = returns_m[range_m > 0.0], range_m[range_m > 0.0]
    if len(returns_m) == 0:
        return returns_m, _FINEST_CELL_RAD
    directions = returns_m / range_m[:, None]
    cell_rad = _FINEST_CELL_RAD
    cells = _cells(directions, cell_rad)
    while (count := len(np.unique(cells))) > _MAX_BEAMS:
        steps = np.log(count / _MAX_BEAMS) / (2.0 * np.log(_CELL_GROWTH))
        cell_rad *= _CELL_GROWTH ** max(1.0, float(np.floor(steps)))
        cells = _cells(directions, cell_rad)
    order = np.lexsort((range_m, cells))
    cells = cells[order]
    ends = np.flatnonzero(np.append(cells[1:] != cells[:-1], True)) + 1
    starts = np.append(0, ends[:-1])
    return np.asarray(returns_m[order[starts + (ends - starts) // 2]]), cell_rad


def _cells(directions: FloatArray, cell_rad: float) -> npt.NDArray[np.int64]:
    return np.asarray(np.floor((directions + 1.0) / cell_rad).astype(np.int64) @ np.array([1 << 40, 1 << 20, 1]))


def _rotation_to_pole(directions: FloatArray) -> FloatArray:
    """Find a rotation that takes the direction farthest from all beams to -z."""
    index = np.arange(_POLE_DIRECTIONS) + 0.5
    polar, azimuth = np.arccos(1.0 - 2.0 * index / _POLE_DIRECTIONS), np.pi * (1.0 + 5.0**0.5) * index
    sphere = np.stack([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], axis=1)
    distance, _ = cKDTree(directions).query(sphere)
    pole = -sphere[largest_index(distance)]
    helper = np.eye(3)[np.argmin(np.abs(pole))]
    x_axis = np.cross(helper, pole)
    x_axis /= np.linalg.norm(x_axis)
    return np.stack([x_axis, np.cross(pole, x_axis), pole])


def _stereographic(directions: FloatArray) -> FloatArray:
    return directions[:, :2] / np.maximum(1.0 + directions[:, 2:], 1e-9)


def _longest_edge_rad(corners: FloatArray) -> FloatArray:
    edges = corners - np.roll(corners, 1, axis=1)
    longest = np.sqrt(np.einsum("ijk,ijk->ij", edges, edges).max(axis=1))
    return np.asarray(2.0 * np.arcsin(np.clip(longest / 2.0, 0.0, 1.0)))


def _planes(corners_m: FloatArray) -> FloatArray:
    """Return the normal divided by the offset of each plane: ``c @ p == 1`` for its three points."""
    normal = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    offset = np.einsum("ij,ij->i", normal, corners_m[:, 0])
    offset = np.where(np.abs(offset) > 1e-12, offset, 1e-12)
    return np.asarray(normal / offset[:, None])
