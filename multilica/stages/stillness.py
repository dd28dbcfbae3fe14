# SPDX-License-Identifier: Apache-2.0
"""Check that the vehicle stood still, by the motion of each LiDAR from frame to frame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
import small_gicp
from scipy.spatial.transform import Rotation

from multilica.config import StillnessConfig
from multilica.geometry import LEVER_ARM_M, FloatArray, lengths
from multilica.registration.neighbours import PointTree, Surface, thin
from multilica.results import BoolArray
from multilica.snapshot import Scan

# The vehicle's own body moves with the LiDAR, which hides the motion.
_BODY_M = 2.5
# Beyond, neighbouring beams are too far apart to show a surface's orientation.
_FAR_M = 40.0
_VOXEL_M = 0.5
_MIN_POINTS = 100
# small_gicp flattens covariances to 1e-3 along the normal, for each of the two clouds.
_NORMAL_VARIANCE_M2 = 2e-3
# Along a tunnel the noise of normals alone makes a tenth of a percent of the points face the motion.
_MIN_FACING_SHARE = 0.005
# The Hessian takes neighbouring points for independent; chance reached 4.3 on a flat field.
_MIN_SIGNIFICANCE = 8.0
# Limit where only one LiDAR sees enough surfaces: a rosette scan of a fence reached 18 at rest.
_ALONE_SIGNIFICANCE = 25.0
# At rest, 0.8 and more in common even where little is seen; a metre of motion leaves less than 0.2.
_TRACKED_BELOW = 0.6
_LOST_BELOW = 0.3

_NEIGHBOURS = 15
# A car at 50 km/h goes 1.4 m in a frame.
_REACHES_M = (1.5, 0.75, 0.4)
# Half the diagonal of a voxel of 0.5 m, and twice what neighbouring voxels of a plane are off it.
_MATCH_M = 0.7
# Shift at which a surface across it no longer counts as the same.
_SEEN_SHIFT_M = 0.2
_MIN_ALIKE = 0.7
# Along a tunnel the noise of normals alone makes a few percent of the points face the motion.
_MIN_FACING_POINT_SHARE = 0.03
_MIN_FACING_POINTS = 20
# 35 m/s at 10 Hz; nearer than the first step, the reach of GICP suffices.
_FARTHEST_STEP_M = 3.6
_STEP_M = 0.4
_MAX_STARTS = 4
_GOOD_SHARE = 0.4
_MIN_FLATNESS = 0.6
# Nothing tells which of two frames is whole.
_TO_COMPARE = 2


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of a LiDAR between its first and last frame.

    Args:
        shift_m, turn_rad: in the directions that surfaces constrain; 0 in the others.
        significance: size of the motion in standard deviations of the registration.
        observable: surfaces constrain all directions, or motion was detected in those that they constrain.
        moving: motion was detected, larger than the configuration allows.
        at_least: shift and turn are lower bounds, as the LiDAR was lost on its way.
    """

    shift_m: float = 0.0
    turn_rad: float = 0.0
    significance: float = 0.0
    observable: bool = False
    moving: bool = False
    at_least: bool = False


def detect_motion(scans: Sequence[Scan], config: StillnessConfig, *, track: bool = True) -> Motion:
    """Detect motion by registering the last whole frame of a LiDAR to its first, through the middle one.

    A driver that starts may send frames without points, or parts of one. If too few surfaces in common are left, the
    LiDAR is tracked from frame to frame.

    Args:
        scans: frames of one LiDAR, oldest first.
        track: False if it is enough to know that too few surfaces are left.

    Returns:
        The motion in the directions that surfaces constrain; along a tunnel or over a plane it is not observable.
    """
    whole = whole_frames(scans)
    chosen = sorted({whole[0], whole[(len(whole) - 1) // 2], whole[-1]}) if whole else []
    clouds_m = [_surroundings(scans[index]) for index in chosen]
    if len(clouds_m) < 2 or min(len(cloud_m) for cloud_m in clouds_m) < _MIN_POINTS:
        return Motion()
    first, *later = map(Structure, clouds_m)
    pose = np.eye(4)
    for structure in later:
        # At constant speed it has gone about twice as far by the last frame as by the middle one.
        result = register_frames(first, structure, pose @ pose)
        pose = result.T_target_source
    found = _motion(result, result.T_target_source, config)
    share, _ = explained_share(first, later[-1], pose)
    if share >= _TRACKED_BELOW:
        # A rosette's pattern over a fence suggests motions of decimetres at rest; if they were real, the frames could
        # not have this much in common without them.
        suggested = found.moving and found.shift_m > _SEEN_SHIFT_M
        at_rest = suggested and explained_share(first, later[-1], np.eye(4))[0] >= _TRACKED_BELOW
        return replace(found, moving=False, observable=False) if at_rest else found
    if not track:
        return replace(found, observable=True, moving=True, at_least=True)
    between = {index: Structure(cloud_m) for index, cloud_m in zip(chosen, clouds_m, strict=True)}
    return _tracked(scans, between, config) or found


def whole_frames(scans: Sequence[Scan]) -> list[int]:
    """Return the indices of the frames with half as many points as usual or more; of two with points, both."""
    counts = np.array([np.count_nonzero(np.isfinite(scan.points_m[:, 0])) for scan in scans], dtype=np.int64)
    filled = np.flatnonzero(counts)
    if len(filled) > _TO_COMPARE:
        filled = filled[2 * counts[filled] >= np.median(counts[filled])]
    return [int(index) for index in filled]


def leaves_its_place(scans: Iterable[Scan]) -> bool:
    """Return whether a LiDAR is half a metre or more away from where its first frame was taken, in any later one.

    Nothing is registered, so that a look at a few frames of a log costs little.
    """
    structures = (Structure(cloud_m) for cloud_m in map(_surroundings, scans) if len(cloud_m) >= _MIN_POINTS)
    first = next(structures, None)
    return first is not None and any(
        explained_share(first, later, np.eye(4))[0] < _TRACKED_BELOW for later in structures
    )


def _tracked(scans: Sequence[Scan], known: Mapping[int, Structure], config: StillnessConfig) -> Motion | None:
    """Follow a LiDAR from frame to frame, also where surfaces leave the reach of GICP; None if that is not possible."""
    frames = []
    for index, scan in enumerate(scans):
        cloud_m = np.empty((0, 3)) if index in known else _surroundings(scan)
        if index in known or len(cloud_m) >= _MIN_POINTS:
            frames.append(known[index] if index in known else Structure(cloud_m))
    pose, step = np.eye(4), np.eye(4)
    steps: list[small_gicp.RegistrationResult] = []
    for target, source in pairwise(frames):
        if (result := _find_step(target, source, step)) is None:
            break
        steps.append(result)
        step = result.T_target_source
        pose = pose @ step
    if steps:
        longest = max(steps, key=lambda each: float(np.linalg.norm(each.T_target_source[:3, 3])))
        motion, is_whole = _motion(longest, pose, config), len(steps) == len(frames) - 1
        if is_whole or motion.moving:
            return replace(motion, at_least=not is_whole)
    share, direction = explained_share(frames[0], frames[1], np.eye(4))
    if share >= _LOST_BELOW or not np.any(direction):
        return None
    return Motion(_SEEN_SHIFT_M, 0.0, np.inf, observable=True, moving=True, at_least=True)


def _surroundings(scan: Scan) -> FloatArray:
    points_m = scan.points_m.astype(np.float64)
    range_m = lengths(points_m)
    return thin(points_m[(range_m > _BODY_M) & (range_m < _FAR_M)], _VOXEL_M)


def _motion(result: small_gicp.RegistrationResult, pose: FloatArray, config: StillnessConfig) -> Motion:
    """Return the motion of a pose (4, 4) that a registration, or a chain with it as the clearest link, has found."""
    rotation, shift_m = pose[:3, :3], pose[:3, 3]
    twist_m = np.concatenate([LEVER_ARM_M * Rotation.from_matrix(rotation).as_rotvec(), rotation.T @ shift_m])
    scale = np.repeat([1.0 / LEVER_ARM_M, 1.0], 3)
    hessian = result.H * np.outer(scale, scale)
    stiffness, directions = np.linalg.eigh(hessian)
    facing = stiffness * _NORMAL_VARIANCE_M2 / max(1, result.num_inliers)
    constrained = directions[:, facing >= _MIN_FACING_SHARE]
    shown_m = constrained @ (constrained.T @ twist_m)
    turn_rad, shown_shift_m = float(np.linalg.norm(shown_m[:3])) / LEVER_ARM_M, float(np.linalg.norm(shown_m[3:]))
    significance = float(np.sqrt(shown_m @ hessian @ shown_m))
    large = bool(shown_shift_m > config.max_shift_m or turn_rad > np.deg2rad(config.max_rotation_deg))
    moving = large and significance > _MIN_SIGNIFICANCE
    return Motion(shown_shift_m, turn_rad, significance, moving or constrained.shape[1] == 6, moving)


def explain_motion(motions: Mapping[str, Motion], source: str = "") -> str:
    """Explain in one sentence why a snapshot read from `source` cannot be used; return "" if it can."""
    moving = {name: motion for name, motion in motions.items() if motion.moving}
    observable = sum(motion.observable for motion in motions.values())
    if 2 * len(moving) <= observable:
        return ""
    if observable == 1 < len(motions) and all(motion.significance < _ALONE_SIGNIFICANCE for motion in moving.values()):
        return ""
    evidence = ", ".join(
        f"{name} by {'at least ' if motion.at_least else ''}{motion.shift_m:.2f} m and "
        f"{np.rad2deg(motion.turn_rad):.1f} deg"
        for name, motion in sorted(moving.items())
    )
    return (
        f"The vehicle moves{' in ' + source if source else ''}: {evidence} between its first and last frame "
        f"({len(moving)} of {observable} LiDARs that can detect motion). Record while it stands still, "
        "or choose another window with --start or --window auto."
    )


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
    kept = strength > max(_MIN_FACING_POINTS, _MIN_FACING_POINT_SHARE * len(normals))
    if not np.any(kept):
        return 1.0, np.zeros(3)
    whitened = axes[:, kept] / np.sqrt(strength[kept])
    shares, directions = np.linalg.eigh(whitened.T @ common @ whitened)
    direction = whitened @ directions[:, 0]
    return float(shares[0]), np.asarray(direction / np.linalg.norm(direction))


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
    return (distance_m < _MATCH_M) & (off_m < _SEEN_SHIFT_M) & (alike > _MIN_ALIKE), normals
