# SPDX-License-Identifier: Apache-2.0
"""Cleaning of a LiDAR's accumulated returns, and removal of points that move between its frames."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from scipy.spatial import cKDTree

from multilica.config import PreprocessConfig, StillnessConfig
from multilica.geometry import Z_AXIS, Float32Array, FloatArray, lengths, read_only, turn_upwards
from multilica.registration.neighbours import thin
from multilica.results import BoolArray, IndexArray, PreprocessedCloud
from multilica.snapshot import LidarScans, Scan
from multilica.solvers.elevation_axis import find_elevation_axis

# 0.2 deg, the usual step of spinning LiDARs.
_FINEST_CELL_RAD = 0.0035
# Bound on time.
_SPACING_SAMPLES = 4000
# The fourth neighbour on a grid is one larger step away, unless one step is over twice the other.
_SPACING_NEIGHBOUR = 4
# Bound on time: more frames show little more of what moved.
_REFERENCE_FRAMES = 10
# In places where nothing moves, edges are a quarter of a percent of the returns.
MOVING_SHARE = 0.005
# With fewer returns than in the point's own frame, the beam that would hit it may be lost.
_MIN_FILLED = 0.85
# Three of nine cells: at this density, chance leaves all nine without a return in one frame of forty.
_DENSE = 0.33
# Fewer frames may all have lost a beam.
_FEWEST_OTHERS = 2
# If more returns than this have no others around them in most frames, the frames show different directions.
_MOST_ALONE = 0.2


def preprocess(
    lidar: LidarScans, config: PreprocessConfig, stillness: StillnessConfig | None = None
) -> PreprocessedCloud:
    """Drop returns that do not measure the static scene, and thin the rest.

    Args:
        stillness: None keeps points that move between frames.

    Returns:
        The kept points in the LiDAR's own frame, with the dropped ones by reason.
    """
    scans, moving = lidar.scans, np.empty((0, 3))
    largest = max((scan.points_m for scan in lidar.scans), key=len, default=np.empty((0, 3)))
    elevation_axis = find_elevation_axis(largest.astype(np.float64))
    if stillness is not None and stillness.enabled:
        scans, moving = drop_moving(scans, stillness, elevation_axis)
    returns_m, too_near_m, too_far_m = map(np.concatenate, zip(*_by_range(scans, config), strict=True))
    dropped = {"too_near": too_near_m, "too_far": too_far_m, "moving": moving}
    return PreprocessedCloud(
        lidar=lidar.name,
        returns_m=read_only(returns_m, np.float32),
        points_m=read_only(thin(returns_m.astype(np.float64), config.voxel_size_m), np.float64),
        dropped_m={reason: points.astype(np.float64) for reason, points in dropped.items() if len(points)},
        elevation_axis=elevation_axis,
    )


def _by_range(scans: Sequence[Scan], config: PreprocessConfig) -> Iterator[tuple[Float32Array, ...]]:
    """Return the points (N, 3) of each frame, after an empty one, that are within the range, too near and too far."""
    for points_m in (np.empty((0, 3), dtype=np.float32), *(scan.points_m for scan in scans)):
        range_m = lengths(points_m)
        too_near = range_m < config.min_range_m
        too_far = np.isfinite(range_m) & (range_m > config.max_range_m)
        yield points_m[np.isfinite(range_m) & ~too_near & ~too_far], points_m[too_near], points_m[too_far]


@dataclass(frozen=True, slots=True, eq=False)
class _Grid:
    """Cells of directions, about as large as the distance between neighbouring beams; the first row is the lowest.

    Args:
        upwards: (3, 3) turns the axis about which the columns lie, away from the beams, to z. Near it they are narrower
            than the distance of beams.
    """

    upwards: FloatArray
    cell_rad: float
    lowest_rad: float
    rows: int
    columns: int

    def cells(self, points_m: FloatArray, range_m: FloatArray) -> IndexArray:
        """Return the cell (N,) of each point."""
        x_m, y_m, z_m = self.upwards @ points_m.T
        row = ((np.arcsin(np.clip(z_m / range_m, -1.0, 1.0)) - self.lowest_rad) / self.cell_rad).astype(np.int64)
        turn = np.arctan2(y_m, x_m) / (2.0 * np.pi) % 1.0
        column = (turn * self.columns).astype(np.int64) % self.columns
        return np.asarray(np.clip(row, 0, self.rows - 1) * self.columns + column)


@dataclass(frozen=True, eq=False)
class _FrameImage:
    """Range image of one frame, with its points.

    Args:
        usable: (N,) which returns of the scan are in the image.
        range_m, cells: (M,) per usable return.
        nearest_m: per cell the smallest range in the 3 x 3 cells around it; inf where they are empty.
        filled: per cell the share of the 3 x 3 cells around it that have a return.
        shape: rows and columns of the cells.
    """

    usable: BoolArray
    range_m: FloatArray
    cells: IndexArray
    nearest_m: FloatArray
    filled: FloatArray
    shape: tuple[int, int]

    @cached_property
    def farthest_m(self) -> FloatArray:
        """Per cell the largest range in the 3 x 3 cells around it; -inf where they are empty."""
        farthest_of_cell_m = np.full(len(self.filled), -np.inf)
        np.maximum.at(farthest_of_cell_m, self.cells, self.range_m)
        return _around(scipy.ndimage.maximum_filter, farthest_of_cell_m.reshape(self.shape))


def drop_moving(
    scans: Sequence[Scan], config: StillnessConfig, elevation_axis: FloatArray = Z_AXIS
) -> tuple[tuple[Scan, ...], FloatArray]:
    """Drop returns of a LiDAR at rest from places that another frame's beams prove empty.

    A return has moved if in some other frame all beams around its direction, at least as densely as in its own, pass
    clearly beyond it. Before the sky beams do not return: a return has also moved if no beam around it does in most
    other frames. That proves nothing of a LiDAR whose frames show different directions. If much has moved, returns go
    as well that lie behind all returns around them in every other frame: no beam passes beyond the farthest place of a
    car that drives off.

    Returns:
        The scans without those returns, and the (K, 3) dropped points.
    """
    returns = [_usable_returns(scan) for scan in scans]
    grid = _grid([usable for _, *usable in returns], elevation_axis) if len(scans) > 1 else None
    if grid is None:
        return tuple(scans), np.empty((0, 3))
    frames = [_frame(*each, grid) for each in returns]
    references = sorted(set(np.linspace(0, len(frames) - 1, _REFERENCE_FRAMES).astype(int).tolist()))
    others = [[frames[other] for other in references if other != index] for index in range(len(frames))]
    moving = [_proven_empty(*each, config.moving_clearance_m) for each in zip(frames, others, strict=True)]
    if sum(map(np.count_nonzero, moving)) > MOVING_SHARE * sum(map(len, moving)):
        hidden = (_hidden(*each, config.moving_clearance_m) for each in zip(frames, others, strict=True))
        moving = [gone | each for gone, each in zip(moving, hidden, strict=True)]
    dropped = [scan.points_m[gone] for scan, gone in zip(scans, moving, strict=True)]
    kept = tuple(_without(scan, gone) for scan, gone in zip(scans, moving, strict=True))
    return kept, np.concatenate(dropped).astype(np.float64)


def _proven_empty(frame: _FrameImage, others: Sequence[_FrameImage], moving_clearance_m: float) -> BoolArray:
    own = frame.filled[frame.cells]
    empty = np.zeros(len(frame.cells), dtype=np.bool_)
    for other in others:
        passed = np.flatnonzero(other.nearest_m[frame.cells] > frame.range_m + moving_clearance_m)
        cells = frame.cells[passed]
        empty[passed] |= np.isfinite(other.nearest_m[cells]) & (other.filled[cells] >= _MIN_FILLED * own[passed])
    alone = _alone(frame, others)
    if np.count_nonzero(alone) < _MOST_ALONE * len(alone):
        empty |= alone & (own >= _DENSE)
    moving = np.zeros(len(frame.usable), dtype=np.bool_)
    moving[frame.usable] = empty
    return moving


def _hidden(frame: _FrameImage, others: Sequence[_FrameImage], moving_clearance_m: float) -> BoolArray:
    """Return which returns (N,) of a scan lie clearly behind all returns around them in every other frame."""
    cells = frame.cells
    dense = _MIN_FILLED * frame.filled[cells]
    behind = np.ones(len(cells), dtype=np.bool_)
    for other in others:
        behind &= (other.farthest_m[cells] < frame.range_m - moving_clearance_m) & (other.filled[cells] >= dense)
    hidden = np.zeros(len(frame.usable), dtype=np.bool_)
    hidden[frame.usable] = behind
    return hidden


def _alone(frame: _FrameImage, others: Sequence[_FrameImage]) -> BoolArray:
    """Return which usable returns of a frame (M,) have no return around them in most of the frames of its size."""
    whole = [other for other in others if 2 * len(other.range_m) >= len(frame.range_m)]
    if len(whole) < _FEWEST_OTHERS:
        return np.zeros(len(frame.cells), dtype=np.bool_)
    return np.asarray(np.mean([~np.isfinite(other.nearest_m[frame.cells]) for other in whole], axis=0) > 0.5)


def _grid(frames: Sequence[Sequence[FloatArray]], elevation_axis: FloatArray) -> _Grid | None:
    """Make the grid for points (M, 3) and ranges (M,) of each frame; None if there are too few points."""
    points_m, range_m = max(frames, key=lambda frame: len(frame[0]))
    if len(points_m) <= _SPACING_NEIGHBOUR:
        return None
    directions = points_m / range_m[:, None]
    sample = directions[:: max(1, len(directions) // _SPACING_SAMPLES)]
    tree = cKDTree(directions, balanced_tree=False, compact_nodes=False)
    distances, _ = tree.query(sample, k=_SPACING_NEIGHBOUR + 1)
    cell_rad = max(_FINEST_CELL_RAD, float(np.median(distances[:, -1])))
    sines = [np.clip(points_m @ elevation_axis / range_m, -1.0, 1.0) for points_m, range_m in frames if len(points_m)]
    lowest, highest = (float(np.arcsin(pick([pick(sine) for sine in sines]))) for pick in (np.min, np.max))
    rows = int((highest - lowest) / cell_rad) + 1
    return _Grid(turn_upwards(elevation_axis), cell_rad, lowest, rows, int(np.ceil(2.0 * np.pi / cell_rad)))


def _usable_returns(scan: Scan) -> tuple[BoolArray, FloatArray, FloatArray]:
    """Return which returns (N,) of a scan are usable, with the points (M, 3) and ranges (M,) of those."""
    points_m = scan.points_m.astype(np.float64)
    range_m = lengths(points_m)
    usable = np.isfinite(range_m) & (range_m > 0.0)
    if not np.all(usable):
        points_m, range_m = points_m[usable], range_m[usable]
    return usable, points_m, range_m


def _frame(usable: BoolArray, points_m: FloatArray, range_m: FloatArray, grid: _Grid) -> _FrameImage:
    cells = grid.cells(points_m, range_m)
    nearest_of_cell_m = np.full(grid.rows * grid.columns, np.inf)
    np.minimum.at(nearest_of_cell_m, cells, range_m)
    image_m = nearest_of_cell_m.reshape(grid.rows, grid.columns)
    nearest_m = _around(scipy.ndimage.minimum_filter, image_m)
    filled = _around(scipy.ndimage.uniform_filter, np.isfinite(image_m).astype(np.float64))
    return _FrameImage(usable, range_m, cells, nearest_m, filled, image_m.shape)


def _around(filter_image: Callable[..., FloatArray], image: FloatArray) -> FloatArray:
    """Return a filter's value of the 3 x 3 cells around each cell, in one row."""
    return filter_image(image, size=3, mode=("nearest", "wrap")).ravel()


def _without(scan: Scan, gone: BoolArray) -> Scan:
    return scan.selected(~gone) if np.any(gone) else scan
