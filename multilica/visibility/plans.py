# SPDX-License-Identifier: Apache-2.0
"""Poses at which the plans of two LiDARs, seen from above, coincide as well as at a known one."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import scipy
from scipy.spatial.transform import Rotation

from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.poses import is_distinct, is_near, moved
from multilica.results import Hypothesis
from multilica.results.hypotheses import REPEATED
from multilica.visibility.sensor_view import PlacedView

# GICP corrects an error of one cell; 256 cells span the common view of two LiDARs.
_CELL_M = 0.5
_CELLS = 256
_TURNED_SHARE = 0.5
# Nearer maxima belong to one pose.
_APART_M = 2.0
# Points that are lower over the lowest one around them are ground, on slopes up to 15 %.
_ABOVE_GROUND_M = 0.3
_AROUND_M = 2.0
# A shift that leaves more of what stands unexplained hides it or puts it into empty space. To score one pose takes as
# long as the plans.
_REPEATED_SHARE = 0.75
_MAX_REPEATED = 3
# Links between stops may share less after a shift, and more shifts are scored.
_SHIFTED_SHARE = 0.3
_MAX_SHIFTED = 16
# Surfaces steeper than 45 deg are walls.
_STRUCTURE = float(np.cos(np.deg2rad(45.0)))
# Normals of one surface differ by 10 deg.
_ONE_AXIS = float(np.cos(np.deg2rad(10.0)))
# The vertical and two directions of walls; what fewer points share makes no plan.
_MAX_AXES = 3
_AXIS_SHARE = 0.1
_AXIS_SAMPLE = 1000
# Fewer points of walls make no plan.
_MIN_POINTS = 50


def main_axes(targets: Sequence[PlacedView], sources: Sequence[PlacedView], pose: RigidTransform) -> list[FloatArray]:
    """Find the normals (3,) that most surfaces of both sides share, the commonest first: one of them is the vertical.

    Walls may have as many points as the ground, and a LiDAR may be mounted at any tilt, so none is preferred.

    Args:
        targets, sources: the members of both groups with their poses in their group's root.
        pose: between the roots; the normals are along the target's axes.

    Returns:
        At most three, at least 45 deg apart, each of a tenth of the surfaces.
    """
    (_, of_targets), (_, of_sources) = _surfaces(targets), _surfaces(sources)
    normals = np.concatenate([of_targets, pose.rotate(of_sources)])
    normals = normals[np.any(normals, axis=1)]
    left = normals[:: 1 + len(normals) // _AXIS_SAMPLE]
    least = max(1.0, _AXIS_SHARE * len(left))
    axes: list[FloatArray] = []
    while len(axes) < _MAX_AXES and len(left):
        near = np.abs(left @ left.T) > _ONE_AXIS
        shared = near[np.argmax(np.sum(near, axis=1))]
        if np.sum(shared) < least:
            break
        axes.append(np.linalg.eigh(left[shared].T @ left[shared])[1][:, -1])
        left = left[np.abs(left @ axes[-1]) < _STRUCTURE]
    return axes


def alike_hypotheses(
    targets: Sequence[PlacedView],
    sources: Sequence[PlacedView],
    start: Hypothesis,
    max_baseline_m: float,
    most_turned: int = 6,
) -> list[Hypothesis]:
    """Find poses at which two groups may fit as well as at a known one: turned by right angles, or repeated.

    Args:
        targets, sources: the members of both groups with their poses in their group's root; one each for a pair.
        start: a pose between the roots.
        most_turned: turned poses about each of `main_axes`.
    """
    pose = start.T_target_source
    found: list[Hypothesis] = []
    for up in main_axes(targets, sources, pose):
        for turned in symmetric_poses(targets, sources, pose, up, max_baseline_m, most_turned):
            words = f"turned by {np.degrees(pose.distance_to(turned)[1]):.0f} deg"
            found.append(replace(start, T_target_source=turned, derivation=words))
        found += repeated_hypotheses(targets, sources, start, up, max_baseline_m)
    return found


def symmetric_poses(
    targets: Sequence[PlacedView],
    sources: Sequence[PlacedView],
    pose: RigidTransform,
    up: FloatArray,
    max_baseline_m: float,
    most: int,
) -> list[RigidTransform]:
    """Find poses at which the walls of both sensors coincide after a turn by 90, 180 or 270 degrees.

    A hall, a garage or a street looks much the same from its other end, and a search by descriptors finds either pose
    by chance. Plans of the walls, seen along `up`, are correlated over all shifts to find the other one.

    Args:
        targets, sources: the members of both groups with their poses in their group's root; one each for a pair.
        pose: ``T_target_source`` between the roots to find competing poses of.
        up: (3,) unit, one of `main_axes`, the axis of the turns.

    Returns:
        Poses whose plans share at least half as many cells as those of `pose`, the best first.
    """
    walls_m, seen_m = _walls(targets, up), pose.rotate(_walls(sources, pose.rotation.T @ up))
    return _coinciding(walls_m, seen_m, pose, up, (1, 2, 3), _TURNED_SHARE, max_baseline_m, most)


def repeated_hypotheses(
    targets: Sequence[PlacedView],
    sources: Sequence[PlacedView],
    start: Hypothesis,
    up: FloatArray,
    max_baseline_m: float,
) -> list[Hypothesis]:
    """Find poses at which what stands above the ground coincides after a shift, as `symmetric_poses` after a turn.

    Trees of an avenue, bays of a car park and pillars repeat in equal steps, in any direction and number. A row also
    repeats after the opposite shift, where the views may share less.

    Args:
        targets, sources: the members of both groups with their poses in their group's root; one each for a pair.
        start: a pose between the roots.
        up: (3,) unit, one of `main_axes`.
    """
    pose = start.T_target_source
    return [
        replace(start, T_target_source=each, derivation=f"{REPEATED} after {pose.distance_to(each)[0]:.1f} m")
        for each in _shifted(targets, sources, pose, up, _REPEATED_SHARE, max_baseline_m, _MAX_REPEATED)
    ]


def shifted_poses(
    targets: Sequence[PlacedView], sources: Sequence[PlacedView], pose: RigidTransform, max_baseline_m: float
) -> list[RigidTransform] | None:
    """Find all poses at which a good part of what stands above the ground coincides after a shift.

    Equal houses and rails with posts repeat over a street of which each LiDAR sees another part, so that the plans
    share less after a shift than at `repeated_hypotheses`.

    Args:
        targets, sources: the members of both groups with their poses in their group's root; one each for a pair.
        pose: ``T_target_source`` between the roots.

    Returns:
        None if too little stands above the ground to tell.
    """
    axes = main_axes(targets, sources, pose)
    standing = [
        _above_ground(side, axis) for up in axes for side, axis in ((targets, up), (sources, pose.rotation.T @ up))
    ]
    if min(map(len, standing), default=0) < _MIN_POINTS:
        return None
    return [
        each
        for up in axes
        for each in _shifted(targets, sources, pose, up, _SHIFTED_SHARE, max_baseline_m, _MAX_SHIFTED)
    ]


def _shifted(
    targets: Sequence[PlacedView],
    sources: Sequence[PlacedView],
    pose: RigidTransform,
    up: FloatArray,
    share: float,
    max_baseline_m: float,
    most: int,
) -> list[RigidTransform]:
    """Find poses after a shift, and after the opposite one, at which a share of what coincides at a pose does again."""
    standing_m, seen_m = _above_ground(targets, up), pose.rotate(_above_ground(sources, pose.rotation.T @ up))
    shifted = _coinciding(standing_m, seen_m, pose, up, (0,), share, max_baseline_m, most)
    kept: list[RigidTransform] = []
    for shift_m in (side * (each.xyz_m - pose.xyz_m) for each in shifted for side in (1.0, -1.0)):
        repeated = moved(pose, np.zeros(3), shift_m)
        if is_near(repeated, max_baseline_m) and is_distinct(repeated, kept, _APART_M):
            kept.append(repeated)
    return kept


def _coinciding(
    target_m: FloatArray,
    seen_m: FloatArray,
    pose: RigidTransform,
    up: FloatArray,
    quarters: Sequence[int],
    share: float,
    max_baseline_m: float,
    most: int,
) -> list[RigidTransform]:
    """Find poses at which the plans of both sides share nearly as many cells as at a pose, after turns and any shift.

    Args:
        target_m, seen_m: (N, 3) along the target's axes, about the origin of each side.
        quarters: turns about `up`, in right angles.
        share: of the cells that coincide at `pose`, how many are enough.
    """
    if min(len(target_m), len(seen_m)) < _MIN_POINTS:
        return []
    across = np.linalg.svd(up[None])[2][1:]
    plan: npt.NDArray[np.complex128] = np.fft.rfft2(
        scipy.ndimage.maximum_filter(_plan((target_m - pose.xyz_m) @ across.T), 3, mode="wrap")
    )
    unturned = _overlap(plan, seen_m @ across.T)
    needed = max(1.0, share * unturned[0, 0])
    found: list[tuple[float, RigidTransform]] = []
    for quarter in quarters:
        turn = Rotation.from_rotvec(0.5 * np.pi * quarter * up).as_matrix()
        overlap = _overlap(plan, seen_m @ turn.T @ across.T) if quarter else unturned
        cells, shifts_m = _maxima(overlap, needed)
        positions_m = pose.xyz_m + shifts_m @ across
        distances_m = np.linalg.norm(positions_m, axis=1)
        if not quarter:
            # The opposite shift may be the one that leaves both on one vehicle.
            opposite_m = np.linalg.norm(pose.xyz_m - shifts_m @ across, axis=1)
            distances_m = np.minimum(distances_m, opposite_m)
        elsewhere = (quarter > 0) | (np.linalg.norm(shifts_m, axis=1) >= _APART_M)
        near = np.flatnonzero((distances_m <= max_baseline_m) & elsewhere)
        for index in near[_apart(shifts_m[near], most)]:
            turned = RigidTransform.from_rotation_translation(
                pose.target, pose.source, turn @ pose.rotation, positions_m[index]
            )
            found.append((float(cells[index]), turned))
    return [turned for _, turned in sorted(found, key=lambda each: -each[0])[:most]]


def _surfaces(members: Sequence[PlacedView]) -> tuple[FloatArray, FloatArray]:
    """Return the probes (N, 3) of a group and their normals, along the axes of its root."""
    points_m = np.concatenate([pose.apply(view.probes_m) for pose, view in members])
    return points_m, np.concatenate([pose.rotate(view.normals) for pose, view in members])


def _walls(members: Sequence[PlacedView], up: FloatArray) -> FloatArray:
    points_m, normals = _surfaces(members)
    upright = np.abs(normals @ up) < _STRUCTURE
    return np.asarray(points_m[upright & np.any(normals, axis=1)])


def _above_ground(members: Sequence[PlacedView], up: FloatArray) -> FloatArray:
    """Select the probes of a group that stand above the lowest ones around them; `up` may point down.

    A ceiling or a roof hides what stands below it in a plan, so level surfaces are left out.
    """
    points_m, normals = _surfaces(members)
    level = np.abs(normals @ up) > _STRUCTURE
    height_m = points_m @ (-up if np.sum(points_m[level] @ up) > 0.0 else up)
    cells = np.floor(points_m @ np.linalg.svd(up[None])[2][1:].T / _AROUND_M).astype(np.int64)
    _, around = np.unique(cells[:, 0] * 2**32 + cells[:, 1], return_inverse=True)
    lowest_m = np.full(len(height_m), np.inf)
    np.minimum.at(lowest_m, around, height_m)
    return np.asarray(points_m[~level & (height_m > lowest_m[around] + _ABOVE_GROUND_M)])


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
    if overlap.max() < needed:
        return np.empty(0), np.empty((0, 2))
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
