# SPDX-License-Identifier: Apache-2.0
"""Ground plane under the vehicle."""

from collections.abc import Mapping

import numpy as np

from multilica.config import CalibrationConfig, GroundConfig
from multilica.geometry import FloatArray, RigidTransform, read_only
from multilica.registration.neighbours import thin
from multilica.results import LEVEL_FRAME, BoolArray, GroundPlane

__all__ = ["BASE_FRAME", "estimate_ground", "estimate_level"]

BASE_FRAME = "base"

# Well below the size of the ground, well above range noise.
_VOXEL_SIZE_M = 0.1
_MIN_POINTS = 100
_LEVEL_POINTS = 3_000
# Enough to rank planes by their points; the best is fitted to all.
_SCORED_POINTS = 4_000
_FITS = 5
# Walls of a hall with its ceiling: the ground is at most the sixth largest plane.
_MAX_PLANES = 6
# Reflections and slopes put a few points below the ground.
_BELOW_DISTANCES = 4.0
_MAX_SHARE_BELOW = 0.05


def estimate_ground(
    target: str, points_m: FloatArray, config: GroundConfig, seed: int
) -> tuple[GroundPlane | None, str]:
    """Fit the ground plane by RANSAC; derive roll, pitch and z of the target LiDAR (the paper, LiDAR-to-ground).

    For a plane ``a x + b y + c z + d = 0`` with its normal upwards, the base frame (ISO 8855: x forward, y left, z up)
    differs from the target frame by pitch ``atan2(-a, sqrt(b^2 + c^2))`` and roll ``atan2(b, c)``; the paper's
    equation gives the pitch up to its sign. A plane does not determine x, y and yaw: they are zero.

    Args:
        target: name of the target LiDAR, whose frame `points_m` (N, 3) are in.

    Returns:
        The plane, or None, and a sentence that describes it or says why there is none.
    """
    points_m = thin(points_m[np.linalg.norm(points_m, axis=1) <= config.max_range_m], _VOXEL_SIZE_M)
    if len(points_m) < _MIN_POINTS:
        return None, f"{len(points_m)} points are too few for a plane; expected {_MIN_POINTS} and more"
    rng = np.random.default_rng(seed)
    left = points_m
    for _ in range(_MAX_PLANES):
        if len(left) < _MIN_POINTS:
            break
        normal, offset_m, on_plane = _largest_plane(left, config, rng)
        if _is_ground(normal, offset_m, points_m, config):
            on_plane = np.abs(points_m @ normal + offset_m) <= config.distance_m
            a, b, c = normal
            roll_pitch_yaw = [np.arctan2(b, c), np.arctan2(-a, np.hypot(b, c)), 0.0]
            pose = RigidTransform.from_xyz_rpy(BASE_FRAME, target, [0.0, 0.0, offset_m], roll_pitch_yaw)
            plane = GroundPlane(read_only(normal, np.float64), offset_m, pose, inlier_share=float(on_plane.mean()))
            text = f"{on_plane.sum()} of {len(points_m)} points lie on a plane {offset_m:.3f} m below {target}"
            return plane, text
        left = left[~on_plane]
    return None, (
        f"none of the {_MAX_PLANES} largest planes lies under the rig: tilted by at most {config.max_tilt_deg:g} deg "
        f"against the z axis of {target}, with nothing below it"
    )


def estimate_level(
    target: str, clouds: Mapping[str, FloatArray], poses: Mapping[str, RigidTransform], config: CalibrationConfig
) -> RigidTransform | None:
    """Estimate the pose of the target LiDAR in a frame with z up; None without a ground plane.

    Args:
        clouds: per LiDAR (N, 3) in its own frame.
        poses: of the placed LiDARs in the target's frame; empty to use the target alone.
    """
    known = poses or {target: RigidTransform.identity(target, target)}
    samples = [pose.apply(_sample(clouds[name], len(known))) for name, pose in known.items() if name in clouds]
    points_m = np.concatenate([np.empty((0, 3)), *samples])
    ground, _ = estimate_ground(target, points_m, config.ground, config.runtime.seed)
    return None if ground is None else RigidTransform(LEVEL_FRAME, target, ground.T_base_target.matrix)


def _sample(points_m: FloatArray, clouds: int) -> FloatArray:
    limit = _LEVEL_POINTS // clouds
    rows = np.random.default_rng(0).choice(len(points_m), min(limit, len(points_m)), replace=False)
    return points_m[np.sort(rows)]


def _largest_plane(
    points_m: FloatArray, config: GroundConfig, rng: np.random.Generator
) -> tuple[FloatArray, float, BoolArray]:
    """Find the plane with the most points by RANSAC (Fischler and Bolles, 1981), fitted to its points.

    Open3D's differs between equal runs: its threads share the random numbers.

    Returns:
        Normal and offset, towards the sensor, since the ground lies below it; and which points lie on it.
    """
    corners = points_m[rng.integers(len(points_m), size=(config.iterations, 3))]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    if not np.any(length > 0.0):
        return np.zeros(3), 0.0, np.ones(len(points_m), dtype=np.bool_)  # one line of points spans no plane
    normals, corners = normals[length > 0.0] / length[length > 0.0, None], corners[length > 0.0]
    offsets_m = np.einsum("ij,ij->i", normals, corners[:, 0])
    sample = points_m if len(points_m) <= _SCORED_POINTS else points_m[rng.choice(len(points_m), _SCORED_POINTS)]
    counts = np.count_nonzero(np.abs(sample @ normals.T - offsets_m) <= config.distance_m, axis=0)
    best = int(np.argmax(counts))
    normal, offset_m = normals[best], -float(offsets_m[best])
    for _ in range(_FITS):
        on_plane = points_m[np.abs(points_m @ normal + offset_m) <= config.distance_m]
        centre_m = on_plane.mean(axis=0)
        normal = np.linalg.eigh((on_plane - centre_m).T @ (on_plane - centre_m))[1][:, 0]
        offset_m = -float(normal @ centre_m)
    if offset_m < 0.0:
        normal, offset_m = -normal, -offset_m
    return normal, offset_m, np.abs(points_m @ normal + offset_m) <= config.distance_m


def _is_ground(normal: FloatArray, offset_m: float, points_m: FloatArray, config: GroundConfig) -> bool:
    tilt_deg = np.rad2deg(np.arccos(np.clip(normal[2], -1.0, 1.0)))
    below = points_m @ normal + offset_m < -_BELOW_DISTANCES * config.distance_m
    return bool(tilt_deg <= config.max_tilt_deg and below.mean() <= _MAX_SHARE_BELOW)
