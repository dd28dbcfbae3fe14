# SPDX-License-Identifier: Apache-2.0
"""Check for dead and dirty LiDARs."""

import numpy as np
import scipy

from multilica.config import HealthConfig
from multilica.geometry import FloatArray, lengths
from multilica.results import BoolArray, IndexArray, Reason, SensorHealth
from multilica.snapshot import LidarScans

# Wider than the gaps between beams of 16 channels (2 deg), so every cell in view has beams.
_CELL_RAD = float(np.deg2rad(5.0))
_ROWS, _COLUMNS = 36, 72
# Three directions determine a plane; a few more show whether there is one.
_MIN_ECHOES = 5
# Range noise is about 2 cm; specks on a window return from anywhere within its near field.
_SURFACE_M = 0.06


def examine_sensor(lidar: LidarScans, near_m: float, config: HealthConfig) -> SensorHealth:
    """Measure the share of a LiDAR's field of view that ends on its own window.

    The field of view is the directions of all returns, in cells of 5 degrees. A cell is blocked if no beam in it gets
    farther than `near_m` and its near echoes lie on no surface (the vehicle's own body is a surface, dirt is not).
    Only blocks of at least 2 x 2 cells count. Directions without returns are ignored: the sky has none, and drivers
    cut out the vehicle's body.

    Args:
        near_m: the calibration ignores nearer returns.
    """
    seen, through = np.zeros((2, _ROWS * _COLUMNS), dtype=np.bool_)
    near_echoes, returns = [(np.empty((0, 3)), np.empty(0), np.empty(0, dtype=np.int64))], 0
    for scan in lidar.scans:
        points_m = scan.points_m.astype(np.float64)
        range_m = lengths(points_m)
        returned = np.isfinite(range_m) & (range_m > 0.0)
        if not np.all(returned):
            points_m, range_m = points_m[returned], range_m[returned]
        near, cells = range_m < near_m, _cells(points_m, range_m)
        seen[cells] = True
        through[cells[~near]] = True
        near_echoes.append((points_m[near] / range_m[near, None], range_m[near], cells[near]))
        returns += len(points_m)
    if returns == 0:
        return SensorHealth(lidar.name, 0, 0.0, 0.0, (Reason("dead", 0.0, 1.0, "it has no returns"),))
    directions, near_range_m, near_cells = (np.concatenate(each) for each in zip(*near_echoes, strict=True))
    blocked = _blocks(_off_surfaces(directions, near_range_m, near_cells) & ~through)
    blockage_ratio = float(_solid_angle(blocked & seen) / _solid_angle(seen))
    limit = config.max_blockage_ratio
    text = (
        f"{blockage_ratio:.0%} of its field of view ends in scattered echoes nearer than {near_m:g} m, as from dirt on "
        f"the window (limit {limit:.0%})"
    )
    reasons = (Reason("dirty", blockage_ratio, limit, text),) if blockage_ratio > limit else ()
    return SensorHealth(lidar.name, returns, len(near_cells) / returns, blockage_ratio, reasons)


def _cells(points_m: FloatArray, range_m: FloatArray) -> IndexArray:
    elevation_rad = np.arcsin(np.clip(points_m[:, 2] / range_m, -1.0, 1.0)) + np.pi / 2.0
    azimuth_rad = np.arctan2(points_m[:, 1], points_m[:, 0]) + np.pi
    rows = np.minimum((elevation_rad / _CELL_RAD).astype(np.int64), _ROWS - 1)
    columns = (azimuth_rad / _CELL_RAD).astype(np.int64) % _COLUMNS
    return np.asarray(rows * _COLUMNS + columns)


def _off_surfaces(directions: FloatArray, range_m: FloatArray, cells: IndexArray) -> BoolArray:
    """Mark the cells whose echoes lie on no plane: on one, the inverse range is linear in the direction."""
    scattered = np.zeros(_ROWS * _COLUMNS, dtype=np.bool_)
    order = np.argsort(cells, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(cells[order])) + 1):
        if len(members) >= _MIN_ECHOES:
            inverse = 1.0 / range_m[members]
            plane, *_ = np.linalg.lstsq(directions[members], inverse, rcond=None)
            off_m = np.abs(directions[members] @ plane - inverse) * range_m[members] ** 2
            scattered[cells[members[0]]] = np.median(off_m) > _SURFACE_M
    return scattered


def _blocks(cells: BoolArray) -> BoolArray:
    """Select the cells that belong to a full block of 2 x 2; azimuth wraps around."""
    image = np.pad(cells.reshape(_ROWS, _COLUMNS), ((0, 0), (1, 1)), mode="wrap")
    return np.asarray(scipy.ndimage.binary_opening(image, structure=np.ones((2, 2)))[:, 1:-1].ravel())


def _solid_angle(cells: BoolArray) -> float:
    rows = np.flatnonzero(cells) // _COLUMNS
    return float(np.sum(np.cos((rows + 0.5) * _CELL_RAD - np.pi / 2.0)))
