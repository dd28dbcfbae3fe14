# SPDX-License-Identifier: Apache-2.0
"""Poses that look like a given one in a scene with right angles."""

import numpy as np
import numpy.typing as npt
import scipy
from scipy.spatial.transform import Rotation

from multilica.geometry import FloatArray, RigidTransform
from multilica.visibility.sensor_view import SensorView

# GICP corrects an error of one cell; 256 cells span the common view of two LiDARs.
_CELL_M = 0.5
_CELLS = 256
# Nearer maxima belong to one pose.
_APART_M = 2.0
# Surfaces steeper than 45 deg are walls.
_STRUCTURE = float(np.cos(np.deg2rad(45.0)))
# Fewer points of walls make no plan.
_MIN_POINTS = 50


def symmetric_poses(
    target: SensorView, source: SensorView, pose: RigidTransform, up: FloatArray, max_baseline_m: float, most: int
) -> list[RigidTransform]:
    """Find poses at which the walls of both sensors coincide after a turn by 90, 180 or 270 degrees.

    A hall, a garage or a street looks much the same from its other end, and a search by descriptors finds either pose
    by chance. Plans of the walls, seen along `up`, are correlated over all shifts to find the other one.

    Args:
        pose: ``T_target_source`` to find competing poses of.
        up: (3,) unit, the commonest surface normal in the target's frame, the axis of the turns.

    Returns:
        Poses whose plans share at least half as many cells as those of `pose`, the best first.
    """
    walls_m, seen_m = _walls(target, up), pose.rotate(_walls(source, pose.rotation.T @ up))
    if min(len(walls_m), len(seen_m)) < _MIN_POINTS:
        return []
    across = np.linalg.svd(up[None])[2][1:]
    plan: npt.NDArray[np.complex128] = np.fft.rfft2(
        scipy.ndimage.maximum_filter(_plan((walls_m - pose.xyz_m) @ across.T), 3, mode="wrap")
    )
    needed = 0.5 * _overlap(plan, seen_m @ across.T)[0, 0]
    found: list[tuple[float, RigidTransform]] = []
    for quarter in (1, 2, 3):
        turn = Rotation.from_rotvec(0.5 * np.pi * quarter * up).as_matrix()
        cells, shifts_m = _maxima(_overlap(plan, seen_m @ turn.T @ across.T), max(needed, 1.0))
        positions_m = pose.xyz_m + shifts_m @ across
        near = np.flatnonzero(np.linalg.norm(positions_m, axis=1) <= max_baseline_m)
        for index in near[_apart(shifts_m[near], most)]:
            turned = RigidTransform.from_rotation_translation(
                pose.target, pose.source, turn @ pose.rotation, positions_m[index]
            )
            found.append((float(cells[index]), turned))
    return [turned for _, turned in sorted(found, key=lambda each: -each[0])[:most]]


def _walls(view: SensorView, up: FloatArray) -> FloatArray:
    upright = np.abs(view.normals @ up) < _STRUCTURE
    return np.asarray(view.probes_m[upright & np.any(view.normals, axis=1)])


def _plan(points_m: FloatArray) -> FloatArray:
    """Compute the (C, C) occupancy of cells seen from above; the origin in cell (0, 0), negative ones wrapped."""
    plan = np.zeros((_CELLS, _CELLS))
    cells = np.floor(points_m / _CELL_M + 0.5).astype(np.int64)
    cells = cells[np.all(np.abs(cells) < _CELLS // 2, axis=1)] % _CELLS
    plan[cells[:, 0], cells[:, 1]] = 1.0
    return plan


def _overlap(plan: npt.NDArray[np.complex128], points_m: FloatArray) -> FloatArray:
    """Count, per shift of the points in cells, the cells that coincide; (C, C)."""
    overlap = np.fft.irfft2(plan * np.conj(np.fft.rfft2(_plan(points_m))), s=(_CELLS, _CELLS))
    return np.asarray(np.rint(overlap), dtype=np.float64)


def _maxima(overlap: FloatArray, needed: float) -> tuple[FloatArray, FloatArray]:
    """Return local maxima with at least this many cells: their cells (N,), most first, and shifts (N, 2) in metres."""
    width = int(_APART_M / _CELL_M) + 1
    highest = scipy.ndimage.maximum_filter(overlap, width, mode="wrap")
    cells = np.argwhere((overlap >= highest - 0.5) & (overlap >= needed))
    cells = cells[np.argsort(-overlap[cells[:, 0], cells[:, 1]], kind="stable")]
    shifts_m = _CELL_M * (((cells + _CELLS // 2) % _CELLS) - _CELLS // 2).astype(np.float64)
    return overlap[cells[:, 0], cells[:, 1]], shifts_m


def _apart(shifts_m: FloatArray, most: int) -> list[int]:
    """Select the first shifts that are not near an earlier one."""
    kept: list[int] = []
    for index, shift_m in enumerate(shifts_m):
        if len(kept) == most:
            break
        if np.all(np.linalg.norm(shifts_m[kept] - shift_m, axis=1) >= _APART_M):
            kept.append(index)
    return kept
