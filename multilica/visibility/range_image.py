# SPDX-License-Identifier: Apache-2.0
"""Range image of one sensor: surface where its beams returned, empty space before it."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import Delaunay, cKDTree

from multilica.geometry import Float32Array, FloatArray, largest_index, lengths
from multilica.results import BeamLabel

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
        normals: (T, 3) unit normal of the plane through the three returns of each triangle, away from the sensor.
        offsets_m: (T,) distance of that plane from the sensor.
        nearest_m: (T,) smallest range of the three returns.
        usable: (T,) the three beams are neighbours.
        smooth: (T,) the three returns can lie on one surface.
        gap_rad: (T,) longest edge where it is the sensor's own gap between two beams; 0 where beams between were left
            out to bound the size.
    """

    to_pole: FloatArray
    triangulation: Any
    normals: FloatArray
    offsets_m: FloatArray
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
# Triangles with a smaller height, in parts of their longest side, count as a line.
_FLATTEST = 1e-12


class _Triangulation(Delaunay):  # type: ignore[misc]  # SciPy has no types
    """A Delaunay triangulation in the plane that computes the affine maps of all its triangles at once.

    SciPy calls LAPACK for each, which takes as long as the triangulation.
    """

    _maps: FloatArray | None = None

    @property
    def transform(self) -> FloatArray:
        """(T, 3, 2) as SciPy defines it: a matrix to barycentric coordinates, then the third corner; NaN if flat."""
        if self._maps is None:
            third = self.points[self.simplices[:, 2]]
            (ax, ay), (bx, by) = ((self.points[self.simplices[:, corner]] - third).T for corner in (0, 1))
            area = ax * by - bx * ay
            longest = np.maximum(ax * ax + ay * ay, bx * bx + by * by)
            with np.errstate(divide="ignore", invalid="ignore"):
                inverse = np.where(np.abs(area) > _FLATTEST * longest, 1.0 / area, np.nan)
            self._maps = np.stack(
                [
                    np.stack([by * inverse, -bx * inverse], axis=1),
                    np.stack([-ay * inverse, ax * inverse], axis=1),
                    np.where(np.isnan(inverse)[:, None], np.nan, third),
                ],
                axis=1,
            )
        return self._maps


def build_range_image(returns_m: Float32Array) -> RangeImage | None:
    """Triangulate the beams of one sensor.

    Args:
        returns_m: (N, 3) returns in the sensor's own frame, the sensor at the origin.

    Returns:
        None if there are too few beams to span a triangle.
    """
    stride = max(1, len(returns_m) // _MAX_RETURNS)
    beams_m, cell_rad = _one_per_cell(returns_m[::stride].astype(np.float64))
    if len(beams_m) < 4:
        return None
    range_m = lengths(beams_m)
    directions = beams_m / range_m[:, None]
    to_pole = _rotation_to_pole(directions)
    triangulation = _Triangulation(_stereographic(beams_m @ to_pole.T, range_m))
    corners = triangulation.simplices
    longest_rad = _longest_edge_rad(directions[corners])
    spacing_rad = float(np.median(longest_rad))
    normals, offsets_m = _planes(beams_m[corners])
    incidence = offsets_m / range_m[corners].mean(axis=1)
    return RangeImage(
        to_pole=to_pole,
        triangulation=triangulation,
        normals=normals,
        offsets_m=offsets_m,
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
    range_m = np.maximum(lengths(points_m), 1e-9)
    triangle = image.triangulation.find_simplex(_stereographic(points_m @ image.to_pole.T, range_m))
    seen = np.flatnonzero((triangle >= 0) & image.usable[triangle])
    triangle, range_m = triangle[seen], range_m[seen]
    beyond_m = np.einsum("ij,ij->i", image.normals[triangle], points_m[seen]) - image.offsets_m[triangle]
    tolerance = tolerance_m + tolerance_rad * range_m
    smooth = image.smooth[triangle]
    before = range_m < image.nearest_m[triangle] - 2.0 * tolerance
    violate = before & ((beyond_m < -2.0 * tolerance) | ~smooth)
    if widths_m is not None:
        violate &= image.gap_rad[triangle] * range_m <= widths_m[seen]
    of_seen = np.where(violate, np.uint8(BeamLabel.VIOLATE), np.uint8(BeamLabel.OCCLUDED))
    of_seen[smooth & (np.abs(beyond_m) <= tolerance)] = BeamLabel.AGREE
    labels = np.full(len(points_m), BeamLabel.UNSEEN, dtype=np.uint8)
    labels[seen] = of_seen
    return labels


def _one_per_cell(returns_m: FloatArray) -> tuple[FloatArray, float]:
    """Select the return of median range per cell of directions; enlarge the cells until there are few enough.

    The number of cells falls at most with the square of their size, often slower: a ring has one row of them.

    Returns:
        The selected returns (M, 3) with the size of the cells.
    """
    range_m = lengths(returns_m)
    if not np.all(range_m > 0.0):
        returns_m, range_m = returns_m[range_m > 0.0], range_m[range_m > 0.0]
    if len(returns_m) == 0:
        return returns_m, _FINEST_CELL_RAD
    directions = np.ascontiguousarray(returns_m.T) / range_m
    cell_rad = _FINEST_CELL_RAD
    cells = _cells(directions, cell_rad)
    while (count := np.count_nonzero(np.diff(np.sort(cells))) + 1) > _MAX_BEAMS:
        steps = np.log(count / _MAX_BEAMS) / (2.0 * np.log(_CELL_GROWTH))
        cell_rad *= _CELL_GROWTH ** max(1.0, float(np.floor(steps)))
        cells = _cells(directions, cell_rad)
    # Positive floats have the order of their bits, so one integer holds cell and range.
    range_bits = range_m.astype(np.float32).view(np.int32)
    order = np.argsort((cells.astype(np.int64) << 32) | range_bits, kind="stable")
    cells = cells[order]
    ends = np.flatnonzero(np.append(cells[1:] != cells[:-1], True)) + 1
    starts = np.append(0, ends[:-1])
    return np.asarray(returns_m[order[starts + (ends - starts) // 2]]), cell_rad


def _cells(directions: FloatArray, cell_rad: float) -> npt.NDArray[np.int32]:
    """Number the cells (N,) of unit vectors (3, N); along each axis there are fewer than 1024."""
    x, y, z = ((directions + 1.0) / cell_rad).astype(np.int32)
    return np.asarray((x << 20) | (y << 10) | z)


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


def _stereographic(points_m: FloatArray, range_m: FloatArray) -> FloatArray:
    return points_m[:, :2] / np.maximum(range_m + points_m[:, 2], 1e-9 * range_m)[:, None]


def _longest_edge_rad(corners: FloatArray) -> FloatArray:
    edges = corners - np.roll(corners, 1, axis=1)
    longest = np.sqrt(np.einsum("ijk,ijk->ij", edges, edges).max(axis=1))
    return np.asarray(2.0 * np.arcsin(np.clip(longest / 2.0, 0.0, 1.0)))


def _planes(corners_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return unit normals (T, 3), away from the origin, and distances (T,) of planes through three points each."""
    normals = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    normals /= np.maximum(lengths(normals), 1e-12)[:, None]
    offsets_m = np.einsum("ij,ij->i", normals, corners_m[:, 0])
    return normals * np.copysign(1.0, offsets_m)[:, None], np.abs(offsets_m)
