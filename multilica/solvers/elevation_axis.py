# SPDX-License-Identifier: Apache-2.0
"""The axis of a LiDAR from which its elevations are counted, found in the directions of its beams."""

import numpy as np
from scipy.spatial import cKDTree

from multilica.geometry import Z_AXIS, FloatArray, fixed_sign, largest_index, lengths

# Bounds on time: beams whose neighbours are looked at, and pairs of such steps that suggest an axis.
_BEAMS = 1500
_DRAWS = 200
# With steps of rows closer than those along a row, two of four neighbours are of the same row.
_NEIGHBOURS = 4
# Beams in the same direction, in radians.
_SAME_BEAM = 1e-5
# Sine of the angle between a step and its row: points rounded to 2 mm turn steps by as much.
_ALONG_ROW = 0.03
# Sine of the least angle between two steps that suggest an axis.
_LEAST_ANGLE = 0.2
# Half to all of the steps are along rows; of the steps of a rosette, a sixth are at right angles to any axis.
_LEAST_SHARE = 0.3
# Mean cosine between beams and axis: all steps of a narrow LiDAR are across the line of sight.
_LINE_OF_SIGHT = 0.9
_REFINEMENTS = 3
_AXES = np.eye(3)
# Cosine of 0.08 degrees: rounding turns an axis of the frame by less.
_SAME_AXIS = 1.0 - 1e-6

# Another axis than z is up if points rise along it by this part of what they rise along z, or, where z is ahead (mean
# cosine of the beams), by as little: half the diagonal of the field of view.
_MUCH_LESS = 0.6
_AHEAD = 0.5
_AS_LITTLE = 1.5


def find_elevation_axis(points_m: FloatArray) -> FloatArray:
    """Return the axis (3,) about which a LiDAR's beams turn, in its frame, its largest component positive.

    A row of beams, such as a ring, has one elevation: steps between neighbours in a row are at right angles to the
    axis, also in a frame that a driver has turned. RANSAC finds the axis with the most such steps (Fischler and Bolles,
    Communications of the ACM, 1981). A rosette has no rows; its axis is that of the frame along which its points rise
    least, z unless another has much less.

    Args:
        points_m: (N, 3) of one frame, not thinned; those at the origin are left out.
    """
    range_m = lengths(points_m)
    usable = np.isfinite(range_m) & (range_m > 0.0)
    beams = points_m[usable] / range_m[usable, None]
    if len(beams) <= _NEIGHBOURS:
        return Z_AXIS
    steps = _steps(beams)
    axis, share = _across_most(steps) if len(steps) else (Z_AXIS, 0.0)
    if share < _LEAST_SHARE or abs(beams.mean(axis=0) @ axis) > _LINE_OF_SIGHT:
        return _least_risen(beams)
    nearest = largest_index(axis)
    return _AXES[nearest] if abs(axis[nearest]) > _SAME_AXIS else fixed_sign(axis)


def _steps(beams: FloatArray) -> FloatArray:
    """Return the directions (N, 3) from some beams to their neighbours."""
    some = beams[:: max(1, len(beams) // _BEAMS)]
    tree = cKDTree(beams, balanced_tree=False, compact_nodes=False)
    _, index = tree.query(some, k=_NEIGHBOURS + 1)
    steps = (beams[index] - some[:, None]).reshape(-1, 3)
    lengths_rad = lengths(steps)
    apart = lengths_rad > _SAME_BEAM
    return np.asarray(steps[apart] / lengths_rad[apart, None])


def _across_most(steps: FloatArray) -> tuple[FloatArray, float]:
    """Return the axis to which most of the steps are at right angles, and their share."""
    first, second = steps[np.random.default_rng(0).integers(len(steps), size=(2, _DRAWS))]
    normals = np.cross(first, second)
    sines = lengths(normals)
    normals = normals[sines > _LEAST_ANGLE] / sines[sines > _LEAST_ANGLE, None]
    if not len(normals):
        return Z_AXIS, 0.0
    axis = normals[np.argmax(np.count_nonzero(np.abs(steps @ normals.T) < _ALONG_ROW, axis=0))]
    for _ in range(_REFINEMENTS):
        along = steps[np.abs(steps @ axis) < _ALONG_ROW]
        axis = np.linalg.eigh(along.T @ along)[1][:, 0]
    return axis, float(np.mean(np.abs(steps @ axis) < _ALONG_ROW))


def _least_risen(beams: FloatArray) -> FloatArray:
    """Return the axis of the frame along which the beams rise least, z unless another has much less."""
    low, high = np.percentile(np.arcsin(np.clip(beams, -1.0, 1.0)), [5.0, 95.0], axis=0)
    is_ahead = np.abs(beams.mean(axis=0)) > _AHEAD
    rises = np.where(is_ahead, np.inf, high - low)
    least = int(np.argmin(rises))
    most = (_AS_LITTLE if is_ahead[2] else _MUCH_LESS) * (high - low)[2]
    return np.asarray(_AXES[least if rises[least] < most else 2])
