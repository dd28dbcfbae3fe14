# SPDX-License-Identifier: Apache-2.0
"""The ground that the vehicle stands on, as a smooth surface."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from multilica.acceptance.placement import imprecision
from multilica.config import AcceptanceConfig, CalibrationConfig, GroundConfig, RefineConfig
from multilica.geometry import FloatArray, RigidTransform, lengths, read_only
from multilica.registration.neighbours import thin
from multilica.results import LEVEL_FRAME, GroundPlane, SensorBias
from multilica.solvers.ground_surface import NEAR_M, GroundSurface, axes_of, fit_surface, nearness_of

# One point per cell, so that points count by the area that they cover, not by the density of the beams.
_CELL_M = 0.3
_MIN_CELLS = 100
_LEVEL_POINTS = 3_000
# A point nearer than this to the ground belongs to it.
_DISTANCE_M = 0.05
_RANSAC_DRAWS = 1000
# Ground is below the LiDARs, but for a slope or a tilted LiDAR. In a tunnel most points are on the walls: of 48 rigs
# in tunnels, garages and fields, draws from all points missed the ground of four.
_ABOVE_SHARE = 0.1
# Enough to rank planes by their points.
_SCORED_POINTS = 4_000
_CANDIDATES = 10
# Reflections and ramps put some points below the ground.
_MAX_SHARE_BELOW = 0.15

# Rotations that turn each axis of a frame upwards, z first, each beside that of the opposite axis.
_UPS = np.stack(
    [
        np.eye(3),
        np.diag([1.0, -1.0, -1.0]),
        [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]],
        [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]],
        [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]],
    ]
)

# The ground may be found about two axes: a slope, or a LiDAR that is tilted by half a right angle.
_SAME_VERTICAL = float(np.cos(np.deg2rad(10.0)))

# From the middle of a car to its wheels, along and across; where the heading is not known, as far as on average.
_WHEELS_M = (1.4, 0.8)
_WHEELS_OF_ANY_HEADING_M = (1.1, 1.1)

# Without doubt: at least this much ground, in cells at no distance, and not on one side of the vehicle only, from where
# the plane under it would be extrapolated.
_MIN_SCORE = 40.0
_MAX_ONE_SIDEDNESS = 0.7


def estimate_ground(
    target: str,
    points_m: FloatArray,
    config: CalibrationConfig,
    middle_m: FloatArray | None = None,
    known: RigidTransform | None = None,
    biases: Sequence[SensorBias] = (),
    least_score: float = -np.inf,
) -> tuple[GroundPlane | None, str]:
    """Find the plane on which the vehicle stands, and from it roll, pitch and z of the target LiDAR (LiDAR-to-ground).

    RANSAC finds the ground, as in the paper. It is no plane, so a smooth surface is fitted to what lies on it, without
    kerbs, pavements, ramps and cars; the plane through the places of the wheels on that surface is the base plane.

    For ``a x + b y + c z + d = 0`` with the normal upwards, the base frame (ISO 8855: x forward, y left, z up) differs
    from the target frame by pitch ``atan2(-a, sqrt(b^2 + c^2))`` and roll ``atan2(b, c)``; the paper's equation gives
    the pitch up to its sign. A plane does not determine x, y and yaw: they are those of `known`.

    Args:
        target: name of the target LiDAR, whose frame `points_m` (N, 3) are in.
        middle_m: (3,) of the vehicle; by default the target.
        known: ``T_base_target`` as a rig file has it; without it x, y and yaw are zero.
        biases: of the LiDARs, if they were estimated.
        least_score: see `GroundSurface.score`; a plane with less is none.

    Returns:
        The plane, or None, and a sentence that describes it or says why there is none.
    """
    middle_m = np.zeros(3) if middle_m is None else middle_m
    points_m = thin(points_m[lengths(points_m - middle_m) <= config.ground.max_range_m], _CELL_M)
    if len(points_m) < _MIN_CELLS:
        return None, f"{len(points_m)} points are too few for a plane, which needs {_MIN_CELLS}"
    found = _find_surface(points_m, middle_m, config, known, _bias_sigmas(biases, config.refine))
    if found is None or found.score < least_score:
        up = f"the z axis of {target}" if known is None else f"the axis of {target} that the rig file has up"
        return None, (
            f"no plane lies under the rig: tilted by at most {config.ground.max_tilt_deg:g} deg against {up}, with "
            "nothing below it"
        )
    if found.cells < _MIN_CELLS:
        return None, f"too little ground is seen: {found.cells} cells of {_CELL_M} m, of which {_MIN_CELLS} are needed"
    frame = config.ground.frame if known is None else known.target
    T_base_target = _pose_over(found, target, middle_m, frame, known)
    plane = GroundPlane(
        normal=found.normal,
        offset_m=float(T_base_target.xyz_m[2]),
        T_base_target=T_base_target,
        inlier_share=found.cells / len(points_m),
        area_m2=found.cells * _CELL_M**2,
        residual_m=found.residual_m,
        sigma_z_m=found.sigma_z_m,
        sigma_roll_pitch_deg=read_only(np.rad2deg(found.sigma_roll_pitch_rad), np.float64),
        doubt=_doubt(found, config.acceptance),
        T_base_target_rig=known,
    )
    return plane, _described(plane)


def estimate_ground_over(
    levels: Sequence[RigidTransform],
    points_m: FloatArray,
    config: CalibrationConfig,
    middle_m: FloatArray,
    known: RigidTransform | None = None,
    biases: Sequence[SensorBias] = (),
) -> tuple[GroundPlane | None, str]:
    """Find the ground as `estimate_ground` does, of a target LiDAR whose z axis is not up.

    Args:
        levels: as `find_levels` finds them, one or more; the first is taken, and others cast a doubt.
    """
    target = levels[0].source
    turn = RigidTransform.from_rotation_translation(target, target, levels[0].rotation, np.zeros(3))
    turned = None if known is None else known @ turn.inverse()
    plane, text = estimate_ground(target, turn.apply(points_m), config, turn.apply(middle_m), turned, biases)
    if plane is None:
        return None, text
    doubt = plane.doubt
    if len(levels) > 1 and not doubt:
        doubt = f"the z axis of {target} is not up, so a wall or a ceiling may be the ground"
    normal, T_base_target = turn.rotation.T @ plane.normal, plane.T_base_target @ turn
    plane = replace(plane, normal=normal, T_base_target=T_base_target, T_base_target_rig=known, doubt=doubt)
    return plane, _described(plane)


def _described(plane: GroundPlane) -> str:
    return f"{plane.area_m2:.0f} m2 of ground are seen" + (f"; {plane.doubt}" if plane.doubt else "")


def _find_surface(
    points_m: FloatArray,
    middle_m: FloatArray,
    config: CalibrationConfig,
    known: RigidTransform | None,
    bias_sigmas: FloatArray,
) -> GroundSurface | None:
    """Return the surface with the highest score, and hardly a point below it."""
    forward = np.array([1.0, 0.0, 0.0]) if known is None else known.rotation[0]
    wheels_m = _WHEELS_OF_ANY_HEADING_M if known is None else _WHEELS_M
    fitted = (
        fit_surface(
            points_m - middle_m, -middle_m, axes_of(normal, forward), height_m, wheels_m, _DISTANCE_M, bias_sigmas
        )
        for normal, height_m in _planes(points_m - middle_m, config.ground, config.runtime.seed)
    )
    below = (each for each in fitted if _height_of_target_m(each, middle_m) > 0.0)
    surfaces = (each for each in below if each.below <= _MAX_SHARE_BELOW)
    return max(surfaces, key=lambda each: each.score, default=None)


def _height_of_target_m(found: GroundSurface, middle_m: FloatArray) -> float:
    return found.offset_m - float(found.normal @ middle_m)


def _pose_over(
    found: GroundSurface, target: str, middle_m: FloatArray, frame: str, known: RigidTransform | None = None
) -> RigidTransform:
    """Return the pose of the target over a surface, with x, y and yaw as known."""
    a, b, c = found.normal
    x_m, y_m, yaw_rad = (0.0, 0.0, 0.0) if known is None else (*known.xyz_m[:2].tolist(), float(known.rpy_rad[2]))
    xyz_m = [x_m, y_m, _height_of_target_m(found, middle_m)]
    return RigidTransform.from_xyz_rpy(
        frame, target, xyz_m, [np.arctan2(b, c), np.arctan2(-a, np.hypot(b, c)), yaw_rad]
    )


def _bias_sigmas(biases: Sequence[SensorBias], config: RefineConfig) -> FloatArray:
    """Return (2,) how far ranges (m) and elevations (rad) may be off: estimated biases are not taken off the points.

    The scale of the ranges is left out: it moves the ground by its product with the height, less than a millimetre.
    """
    if not biases:
        return np.array([config.range_bias_sigma_m, np.deg2rad(config.elevation_bias_sigma_deg)])
    range_m = max(np.hypot(each.range_m, each.range_sigma_m) for each in biases)
    elevation_deg = max(np.hypot(each.elevation_deg, each.elevation_sigma_deg) for each in biases)
    return np.array([range_m, np.deg2rad(elevation_deg)])


def _doubt(found: GroundSurface, limits: AcceptanceConfig) -> str:
    """Return why the plane is uncertain; empty if it is not."""
    imprecise = imprecision(found.sigma_z_m, float(found.sigma_roll_pitch_rad.max()), limits)
    if imprecise is not None:
        return imprecise.text
    if found.score < _MIN_SCORE:
        return "next to no ground is seen near the vehicle"
    if found.one_sidedness > _MAX_ONE_SIDEDNESS:
        return "ground is seen on one side of the vehicle only"
    return ""


def middle_of(poses: Mapping[str, RigidTransform]) -> FloatArray:
    """Return the middle (3,) of LiDARs in their common frame, which lies over that of the vehicle."""
    return np.asarray(np.mean([pose.xyz_m for pose in poses.values()], axis=0))


def _planes(points_m: FloatArray, config: GroundConfig, seed: int) -> Iterator[tuple[FloatArray, float]]:
    """Find planes with the most points near the origin by RANSAC (Fischler and Bolles, 1981).

    Open3D's differs between equal runs: its threads share the random numbers.

    Yields:
        Normal (3,), upwards, and height of the origin over the plane; distinct ones, the one with the most points
        first.
    """
    rng = np.random.default_rng(seed)
    nearness = nearness_of(points_m)
    share = np.sqrt(nearness) * np.where(points_m[:, 2] < 0.0, 1.0, _ABOVE_SHARE)
    corners = points_m[rng.choice(len(points_m), (_RANSAC_DRAWS, 3), p=share / share.sum())]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals[normals[:, 2] < 0.0] *= -1.0
    length = lengths(normals)
    flat = normals[:, 2] > np.cos(np.deg2rad(config.max_tilt_deg)) * length
    normals, corners = normals[flat] / length[flat, None], corners[flat]
    heights_m = -np.einsum("ij,ij->i", normals, corners[:, 0])
    normals, heights_m = normals[heights_m > 0.0], heights_m[heights_m > 0.0]
    rows = np.arange(len(points_m))
    if len(points_m) > _SCORED_POINTS:
        rows = np.sort(rng.choice(len(points_m), _SCORED_POINTS, replace=False))
    above_m = points_m[rows] @ normals.T + heights_m
    on_plane, below = np.abs(above_m) <= _DISTANCE_M / 2.0, above_m < -2.0 * _DISTANCE_M
    scores = nearness[rows] @ on_plane - nearness[rows] @ below
    around_m = NEAR_M * np.concatenate([np.eye(3), -np.eye(3)]) @ normals.T + heights_m
    chosen: list[int] = []
    for index in np.argsort(-scores, kind="stable").tolist():
        if all(np.abs(around_m[:, index] - around_m[:, other]).max() > _DISTANCE_M for other in chosen):
            chosen.append(index)
            yield normals[index], float(heights_m[index])
        if len(chosen) == _CANDIDATES:
            return


def estimate_level(
    target: str, clouds: Mapping[str, FloatArray], poses: Mapping[str, RigidTransform], config: CalibrationConfig
) -> RigidTransform | None:
    """Estimate the pose of the target LiDAR in a frame with z up; None without a ground plane about any axis.

    Args:
        clouds: per LiDAR (N, 3) in its own frame.
        poses: of the placed LiDARs in the target's frame; empty to use the target alone.
    """
    about_z = estimate_level_about_z(target, clouds, poses, config)
    return about_z or next(iter(find_levels(target, clouds, poses, config)), None)


def estimate_level_about_z(
    target: str,
    clouds: Mapping[str, FloatArray],
    poses: Mapping[str, RigidTransform],
    config: CalibrationConfig,
    least_score: float = -np.inf,
) -> RigidTransform | None:
    """Estimate the same for a target whose z axis is up.

    Args:
        clouds, poses: as of `estimate_level`.
        least_score: of the plane; see `GroundSurface.score`.
    """
    points_m, middle_m = _level_points(target, clouds, poses)
    ground, _ = estimate_ground(target, points_m, config, middle_m, least_score=least_score)
    return None if ground is None else RigidTransform(LEVEL_FRAME, target, ground.T_base_target.matrix)


def find_levels(
    target: str,
    clouds: Mapping[str, FloatArray],
    poses: Mapping[str, RigidTransform],
    config: CalibrationConfig,
    least_score: float = -np.inf,
) -> list[RigidTransform]:
    """Find the possible poses of the target LiDAR in a frame with z up, whichever axis its driver has up.

    The ground about z counts always. A wall may look like the ground, so that about another axis counts if its score is
    half the best or more. A ceiling may be seen better than the ground: of opposite axes, both count.

    Args:
        clouds, poses: as of `estimate_level`.
        least_score: of a plane; see `GroundSurface.score`.

    Returns:
        That about z first, then those with the most ground; none without any plane.
    """
    points_m, middle_m = _level_points(target, clouds, poses)
    points_m = thin(points_m[lengths(points_m - middle_m) <= config.ground.max_range_m], _CELL_M)
    if len(points_m) < _MIN_CELLS:
        return []
    bias_sigmas = _bias_sigmas((), config.refine)
    found: dict[int, tuple[float, RigidTransform]] = {}
    for axis, up in enumerate(_UPS):
        surface = _find_surface(points_m @ up.T, up @ middle_m, config, None, bias_sigmas)
        if surface is None or surface.cells < _MIN_CELLS or surface.score < least_score:
            continue
        turn = RigidTransform.from_rotation_translation(target, target, up, np.zeros(3))
        level = _pose_over(surface, target, up @ middle_m, LEVEL_FRAME) @ turn
        if all(level.rotation[2] @ other.rotation[2] < _SAME_VERTICAL for _, other in found.values()):
            found[axis] = surface.score, level
    least = 0.5 * max((score for score, _ in found.values()), default=0.0)
    likely = {axis for axis, (score, _) in found.items() if axis == 0 or score >= least}
    ranked = sorted(found, key=lambda axis: (axis > 0, -found[axis][0]))
    return [found[axis][1] for axis in ranked if axis in likely or axis ^ 1 in likely]


def level_near(T_base_target: RigidTransform) -> RigidTransform:
    """Return the level with that axis of the target up which a rig file has nearest to the vertical."""
    up = max(_UPS, key=lambda each: float(each[2] @ T_base_target.rotation[2]))
    return RigidTransform.from_rotation_translation(LEVEL_FRAME, T_base_target.source, up, np.zeros(3))


def rotations_of(levels: Sequence[RigidTransform]) -> list[FloatArray]:
    """Return the rotations (3, 3) of levels; without any, each axis may be up."""
    return [level.rotation for level in levels] or [*_UPS]


def _level_points(
    target: str, clouds: Mapping[str, FloatArray], poses: Mapping[str, RigidTransform]
) -> tuple[FloatArray, FloatArray]:
    """Return some points (N, 3) of LiDARs in the target's frame, and the middle (3,) of these LiDARs."""
    known = poses or {target: RigidTransform.identity(target, target)}
    samples = []
    for name, pose in known.items():
        if (points_m := clouds.get(name)) is not None:
            most = min(_LEVEL_POINTS // len(known), len(points_m))
            rows = np.random.default_rng(0).choice(len(points_m), most, replace=False)
            samples.append(pose.apply(points_m[np.sort(rows)]))
    return np.concatenate([np.empty((0, 3)), *samples]), middle_of(known)
