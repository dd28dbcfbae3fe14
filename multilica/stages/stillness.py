# SPDX-License-Identifier: Apache-2.0
"""Check that the vehicle stood still."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import small_gicp
from scipy.spatial.transform import Rotation

from multilica.config import StillnessConfig
from multilica.geometry import LEVER_ARM_M, FloatArray, lengths
from multilica.registration.neighbours import thin
from multilica.registration.tracking import (
    SEEN_SHIFT_M,
    Structure,
    explained_share,
    register_frames,
    track_frames,
)
from multilica.snapshot import Scan


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


def detect_motion(scans: Sequence[Scan], config: StillnessConfig) -> Motion:
    """Detect motion by registering the last frame of a LiDAR to its first, through the middle one.

    If too few surfaces in common are left, the LiDAR is tracked from frame to frame.

    Args:
        scans: frames of one LiDAR, oldest first.

    Returns:
        The motion in the directions that surfaces constrain; along a tunnel or over a plane it is not observable.
    """
    chosen = sorted({0, (len(scans) - 1) // 2, len(scans) - 1}) if scans else []
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
        return _confirmed(found, first, later[-1])
    between = {index: Structure(cloud_m) for index, cloud_m in zip(chosen, clouds_m, strict=True)}
    return _tracked(scans, between, config) or found


def _confirmed(found: Motion, first: Structure, last: Structure) -> Motion:
    """Return the motion, unless it is so large that the frames could not have this much in common without it.

    A rosette's pattern over a fence suggests motions of decimetres at rest.
    """
    if found.moving and found.shift_m > SEEN_SHIFT_M and explained_share(first, last, np.eye(4))[0] >= _TRACKED_BELOW:
        return replace(found, moving=False, observable=False)
    return found


def _tracked(scans: Sequence[Scan], known: Mapping[int, Structure], config: StillnessConfig) -> Motion | None:
    """Track a LiDAR through all frames; None if that is not possible either."""
    frames = []
    for index, scan in enumerate(scans):
        cloud_m = np.empty((0, 3)) if index in known else _surroundings(scan)
        if index in known or len(cloud_m) >= _MIN_POINTS:
            frames.append(known[index] if index in known else Structure(cloud_m))
    track = track_frames(frames)
    if track is not None:
        motion = _motion(track.step, track.T_first_last, config)
        if track.is_whole or motion.moving:
            return replace(motion, at_least=not track.is_whole)
    share, direction = explained_share(frames[0], frames[1], np.eye(4))
    if share >= _LOST_BELOW or not np.any(direction):
        return None
    return Motion(SEEN_SHIFT_M, 0.0, np.inf, observable=True, moving=True, at_least=True)


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
