# SPDX-License-Identifier: Apache-2.0
"""Poses that a scene of right angles can be mistaken for."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import fft, ndimage
from scipy.spatial.transform import Rotation

from multilica.geometry import FloatArray, RigidTransform
from multilica.stages.witness import Witness

__all__ = ["turned_rivals"]

_CELL_M = 0.5
_CELLS = 256
_APART_M = 2.0
_STRUCTURE = float(np.cos(np.deg2rad(45.0)))
_MIN_POINTS = 50


def turned_rivals(
    target: Witness, source: Witness, pose: RigidTransform, up: FloatArray, reach_m: float, most: int
) -> list[RigidTransform]:
    """Where the walls of both sensors fall together again once the source is turned by 90, 180 or 270 degrees.

    A hall, a garage or a street looks much the same from its other end. Which of both poses a search by descriptors
    comes upon is chance, so the other one is looked for here: plans of the walls, as seen along `up`, are correlated
    over all shifts.

    Args:
        target, source: what both sensors testify.
        pose: ``T_target_source`` to find rivals of.
        up: (3,) unit, the commonest surface normal in the target's frame, which turns leave as it is.
        reach_m: a LiDAR of the same vehicle is no farther from the target than this.
        most: number of rivals.

    Returns:
        Poses whose plans share at least half as many cells as those of `pose`, the best first.
    """
    walls_m, seen_m = _walls(target, up), pose.rotate(_walls(source, pose.rotation.T @ up))
    if min(len(walls_m), len(seen_m)) < _MIN_POINTS:
        return []
    across = np.linalg.svd(up[None])[2][1:]
    plan: npt.NDArray[np.complex128] = fft.rfft2(
        ndimage.maximum_filter(_plan((walls_m - pose.xyz_m) @ across.T), 3, mode="wrap")
    )
    needed = 0.5 * _overlap(plan, seen_m @ across.T)[0, 0]
    found: list[tuple[float, RigidTransform]] = []
    for quarter in (1, 2, 3):
        turn = Rotation.from_rotvec(0.5 * np.pi * quarter * up).as_matrix()
        cells, shifts_m = _maxima(_overlap(plan, seen_m @ turn.T @ across.T), max(needed, 1.0))
        positions_m = pose.xyz_m + shifts_m @ across
        near = np.flatnonzero(np.linalg.norm(positions_m, axis=1) <= reach_m)
        for index in near[_apart(shifts_m[near], most)]:
            rival = RigidTransform.from_rotation_translation(
                pose.target, pose.source, turn @ pose.rotation, positions_m[index]
            )
            found.append((float(cells[index]), rival))
    return [rival for _, rival in sorted(found, key=lambda each: -each[0])[:most]]


def _walls(witness: Witness, up: FloatArray) -> FloatArray:
    upright = np.abs(witness.normals @ up) < _STRUCTURE
    return np.asarray(witness.probes_m[upright & np.any(witness.normals, axis=1)])


def _plan(points_m: FloatArray) -> FloatArray:
    """(C, C) occupancy of cells seen from above; the origin in cell (0, 0), negative ones wrapped around."""
    plan = np.zeros((_CELLS, _CELLS))
    cells = np.floor(points_m / _CELL_M + 0.5).astype(np.int64)
    cells = cells[np.all(np.abs(cells) < _CELLS // 2, axis=1)] % _CELLS
    plan[cells[:, 0], cells[:, 1]] = 1.0
    return plan


def _overlap(plan: npt.NDArray[np.complex128], points_m: FloatArray) -> FloatArray:
    """(C, C) number of cells that fall together, per shift of the points in cells."""
    overlap = fft.irfft2(plan * np.conj(fft.rfft2(_plan(points_m))), s=(_CELLS, _CELLS))
    return np.asarray(overlap, dtype=np.float64)


def _maxima(overlap: FloatArray, needed: float) -> tuple[FloatArray, FloatArray]:
    """Local maxima with at least so many cells: the cells (N,), most first, and the shifts (N, 2) in metres."""
    width = int(_APART_M / _CELL_M) + 1
    highest = ndimage.maximum_filter(overlap, width, mode="wrap")
    cells = np.argwhere((overlap >= highest - 0.5) & (overlap >= needed))
    cells = cells[np.argsort(-overlap[cells[:, 0], cells[:, 1]], kind="stable")]
    shifts_m = _CELL_M * (((cells + _CELLS // 2) % _CELLS) - _CELLS // 2).astype(np.float64)
    return overlap[cells[:, 0], cells[:, 1]], shifts_m


def _apart(shifts_m: FloatArray, most: int) -> list[int]:
    """The first shifts of which none is near an earlier one."""
    kept: list[int] = []
    for index, shift_m in enumerate(shifts_m):
        if len(kept) == most:
            break
        if np.all(np.linalg.norm(shifts_m[kept] - shift_m, axis=1) >= _APART_M):
            kept.append(index)
    return kept
