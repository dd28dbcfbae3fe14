# SPDX-License-Identifier: Apache-2.0
"""The motion of a LiDAR from frame to frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import small_gicp

from multilica.geometry import FloatArray, lengths
from multilica.registration.neighbours import PointTree, Surface
from multilica.results import BoolArray

_NEIGHBOURS = 15
# A car at 50 km/h goes 1.4 m in a frame.
_REACHES_M = (1.5, 0.75, 0.4)
# Half the diagonal of a voxel of 0.5 m, and twice what neighbouring voxels of a plane are off it.
_MATCH_M = 0.7
SEEN_SHIFT_M = 0.2
"""Shift at which a surface across it no longer counts as the same."""
_MIN_ALIKE = 0.7
# Along a tunnel the noise of normals alone makes a few percent of the points face the motion.
_MIN_FACING_SHARE = 0.03
_MIN_FACING_POINTS = 20
# 35 m/s at 10 Hz; nearer than the first step, the reach of GICP suffices.
_FARTHEST_STEP_M = 3.6
_STEP_M = 0.4
_MAX_STARTS = 4
_GOOD_SHARE = 0.4
_MIN_FLATNESS = 0.6


class Structure:
    """The points of a frame with the surfaces about them.

    Args:
        points_m: (N, 3).
    """

    def __init__(self, points_m: FloatArray) -> None:
        self.tree = PointTree(points_m)
        self.surface = Surface(self.tree, _NEIGHBOURS)
        small_gicp.estimate_covariances(self.tree.cloud, self.tree.engine, num_neighbors=_NEIGHBOURS, num_threads=1)

    @cached_property
    def flat(self) -> tuple[FloatArray, FloatArray]:
        """Points (M, 3) on surfaces and their unit normals (M, 3) of either sign; rain and foliage have none."""
        normals, flatness = self.surface.at(np.arange(len(self.tree.points_m)))
        chosen = flatness > _MIN_FLATNESS
        return self.tree.points_m[chosen], normals[chosen]

    @cached_property
    def range_m(self) -> float:
        """Largest distance of a point."""
        return float(lengths(self.tree.points_m).max())


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """The motion over several frames.

    Args:
        T_first_last: (4, 4) pose of the last frame that was reached in the first.
        step: registration of the longest single step.
        is_whole: every frame was reached.
    """

    T_first_last: FloatArray
    step: small_gicp.RegistrationResult
    is_whole: bool


def register_frames(target: Structure, source: Structure, start: FloatArray) -> small_gicp.RegistrationResult:
    """Register a frame to another with GICP, with ever smaller reaches, from a pose (4, 4)."""
    for reach_m in _REACHES_M:
        result = small_gicp.align(
            target.tree.cloud,
            source.tree.cloud,
            target.tree.engine,
            init_T_target_source=start,
            registration_type="GICP",
            max_correspondence_distance=reach_m,
            num_threads=1,
            max_iterations=15,
            rotation_epsilon=1e-4,
            translation_epsilon=1e-4,
        )
        start = result.T_target_source
    return result


def explained_share(target: Structure, source: Structure, T_target_source: FloatArray) -> tuple[float, FloatArray]:
    """Return the share of surfaces that two frames have in common, in the direction (3,) where it is least.

    A shift hides in the surfaces along it, which match as well as before: a wall beside the vehicle, the ground. Only
    surfaces across it show it. So the share is that of matched surfaces among those that face a direction, the least
    over all directions that enough surfaces face; 1 without any.
    """
    matched, normals = _matched(target, source, T_target_source)
    facing, common = normals.T @ normals, normals[matched].T @ normals[matched]
    strength, axes = np.linalg.eigh(facing)
    kept = strength > max(_MIN_FACING_POINTS, _MIN_FACING_SHARE * len(normals))
    if not np.any(kept):
        return 1.0, np.zeros(3)
    whitened = axes[:, kept] / np.sqrt(strength[kept])
    shares, directions = np.linalg.eigh(whitened.T @ common @ whitened)
    direction = whitened @ directions[:, 0]
    return float(shares[0]), np.asarray(direction / np.linalg.norm(direction))


def track_frames(frames: Sequence[Structure]) -> Track | None:
    """Follow a LiDAR from frame to frame, also at speeds at which surfaces leave the reach of GICP.

    Returns:
        None if not even the first step can be found.
    """
    pose, step = np.eye(4), np.eye(4)
    steps: list[small_gicp.RegistrationResult] = []
    for target, source in pairwise(frames):
        result = _find_step(target, source, step)
        if result is None:
            break
        steps.append(result)
        step = result.T_target_source
        pose = pose @ step
    if not steps:
        return None
    longest = max(steps, key=lambda each: float(np.linalg.norm(each.T_target_source[:3, 3])))
    return Track(pose, longest, is_whole=len(steps) == len(frames) - 1)


def _find_step(target: Structure, source: Structure, start: FloatArray) -> small_gicp.RegistrationResult | None:
    """Register a frame to the one before, from the last step, else from steps along the least explained direction."""
    best = register_frames(target, source, start)
    share, direction = explained_share(target, source, best.T_target_source)
    if share < _GOOD_SHARE:
        for other in _starts(target, source, start, direction):
            result = register_frames(target, source, other)
            found, _ = explained_share(target, source, result.T_target_source)
            if found > share:
                best, share = result, found
    return best if share >= _GOOD_SHARE else None


def _starts(target: Structure, source: Structure, start: FloatArray, direction: FloatArray) -> list[FloatArray]:
    """Return the shifts of a start along a direction that explain most of the surfaces facing it, the best first."""
    sizes_m = np.arange(_STEP_M, _FARTHEST_STEP_M, _STEP_M)
    starts, scores = [], []
    for shift_m in (*sizes_m, *-sizes_m):
        moved = start.copy()
        moved[:3, 3] = shift_m * direction
        matched, normals = _matched(target, source, moved, direction)
        starts.append(moved)
        scores.append(float(np.mean(matched)) if len(normals) else 0.0)
    return [starts[index] for index in np.argsort(scores, kind="stable")[::-1][:_MAX_STARTS]]


def _matched(
    target: Structure, source: Structure, pose: FloatArray, facing: FloatArray | None = None
) -> tuple[BoolArray, FloatArray]:
    """Return which points on surfaces, all or those that face a direction (3,), match, and their normals there."""
    points_m, normals = (values @ pose[:3, :3].T for values in source.flat)
    points_m += pose[:3, 3]
    # Points beyond the target's range may well be new.
    kept = lengths(points_m) < target.range_m
    if facing is not None:
        kept &= np.abs(normals @ facing) > _MIN_ALIKE
    points_m, normals = np.ascontiguousarray(points_m[kept]), normals[kept]
    if not len(points_m):
        return np.zeros(0, dtype=np.bool_), normals
    distance_m, index = target.tree.nearest(points_m)
    found, _ = target.surface.at(index)
    off_m = np.abs(np.einsum("ij,ij->i", found, points_m - target.tree.points_m[index]))
    alike = np.abs(np.einsum("ij,ij->i", found, normals))
    return (distance_m < _MATCH_M) & (off_m < SEEN_SHIFT_M) & (alike > _MIN_ALIKE), normals
