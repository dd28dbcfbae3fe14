# SPDX-License-Identifier: Apache-2.0
"""The ground that the vehicle stands on, as a smooth surface."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from multilica.acceptance.placement import imprecision
from multilica.config import AcceptanceConfig, CalibrationConfig, GroundConfig, RefineConfig
from multilica.geometry import FloatArray, RigidTransform, lengths, read_only
from multilica.registration.neighbours import thin
from multilica.results import LEVEL_FRAME, GroundPlane, SensorBias

# At this distance a point counts half, or a quarter: what is near is more likely to be what the wheels stand on.
NEAR_M = 5.0
_BELOW_DISTANCES = 4.0
# Distance of ground from a plane, one standard deviation: crests of 500 m radius, the change of that curvature within
# some 10 m, and an error that grows with the fourth power of the distance.
_CURVATURE_1_M = 0.002
_CURVATURE_CHANGE_1_M2 = 2e-4
_MODEL_ERROR_1_M3 = 7e-7
# The ground below a wheel is not seen: ruts, stones, the tyre itself.
_UNEVENNESS_M = 0.002
_FITS = 15
_HIGHEST_M = 0.5
_MIN_NOISE_M = 0.003
_TUKEY = 4.685
# The LiDARs stand about as high over the middle of the vehicle.
_SENSOR_HEIGHT_M = 1.5
# Points this near to each other share errors: of the ground, and of the pose of the LiDAR that saw them.
_TILE_M = 2.0

# One point per cell, so that points count by the area that they cover, not by the density of the beams.
_CELL_M = 0.3
_MIN_CELLS = 100
_LEVEL_POINTS = 3_000
# A point nearer than this to the ground belongs to it.
_DISTANCE_M = 0.05
_RANSAC_DRAWS = 1000
# Enough to rank planes by their points.
_SCORED_POINTS = 4_000
_CANDIDATES = 10
# Reflections and ramps put some points below the ground.
_MAX_SHARE_BELOW = 0.15

# From the middle of a car to its wheels, along and across; where the heading is not known, as far as on average.
_WHEELS_M = (1.4, 0.8)
_WHEELS_OF_ANY_HEADING_M = (1.1, 1.1)

# Without doubt: at least this much ground, in cells at no distance, and not on one side of the vehicle only, from where
# the plane under it would be extrapolated.
_MIN_SCORE = 40.0
_MAX_ONE_SIDEDNESS = 0.7


@dataclass(frozen=True, slots=True, eq=False)
class GroundSurface:
    """A smooth surface that is fitted to the ground.

    Args:
        normal, offset_m: of the plane through the places of the wheels.
        sigma_z_m, sigma_roll_pitch_rad: of the target over that plane, and (2,) about the axes forward and left.
        cells: number of cells on the surface.
        residual_m: RMS of their distances.
        score: their number, where cells at a distance count less and cells below the surface against it.
        below: share of the cells that are far below it.
        one_sidedness: 0 if they surround the vehicle, 1 if they lie in one direction from it.
    """

    normal: FloatArray
    offset_m: float
    sigma_z_m: float
    sigma_roll_pitch_rad: FloatArray
    cells: int
    residual_m: float
    score: float
    below: float
    one_sidedness: float


def nearness_of(points_m: FloatArray) -> FloatArray:
    """Return the weights (N,) of points by their distance from the origin: 1 there, a quarter at `NEAR_M`."""
    return np.asarray((1.0 + np.einsum("ij,ij->i", points_m, points_m) / NEAR_M**2) ** -2)


def axes_of(normal: FloatArray, forward: FloatArray) -> FloatArray:
    """Return the axes (3, 3) of a plane as rows: along `forward` (3,), to the left of it, and upwards."""
    along = forward - (forward @ normal) * normal
    along /= np.linalg.norm(along)
    return np.stack([along, np.cross(normal, along), normal])


def fit_surface(
    points_m: FloatArray,
    target_m: FloatArray,
    axes: FloatArray,
    height_m: float,
    wheels_m: tuple[float, float],
    distance_m: float,
    bias_sigmas: FloatArray,
) -> GroundSurface:
    """Fit a polynomial of third degree to the points (N, 3) near a plane, robustly (Tukey's biweight).

    The ground under the vehicle is extrapolated from the ground around it, which is smooth. Its curvature and the
    change of curvature are unknowns with a standard deviation each, and widen the covariance if they matter. So do
    errors that neighbours share: it is the sandwich of scores that are summed over tiles (Liang and Zeger, 1986), with
    the biases in range and elevation of one LiDAR over the middle. The shape of the ground hardly shows these.

    Args:
        points_m, target_m: the latter (3,); relative to the middle of the vehicle.
        axes: (3, 3), rows; the last one is the normal of the plane.
        height_m: of the middle over the plane.
        bias_sigmas: (2,) standard deviations of range (m) and elevation (rad).
    """
    points_m, target_m = points_m @ axes.T, target_m @ axes.T
    all_nearness = nearness_of(points_m).sum()
    points_m = points_m[points_m[:, 2] + height_m < _HIGHEST_M]
    places_m, heights_m = points_m[:, :2], points_m[:, 2] + height_m
    terms = _terms(places_m)
    expected = np.array([1.0, 1.0, 1.0, *[_CURVATURE_1_M] * 3, *[_CURVATURE_CHANGE_1_M2] * 4])
    prior = np.diag(expected**-2.0)
    model_m = _MODEL_ERROR_1_M3 * np.einsum("ij,ij->i", places_m, places_m) ** 2
    noise_m, found, weights = distance_m / 3.0, np.zeros(len(expected)), np.zeros(len(points_m))
    information = prior
    for _ in range(_FITS):
        deviation_m = np.hypot(noise_m, model_m)
        scaled = (heights_m - terms @ found) / np.minimum(_TUKEY * deviation_m, distance_m)
        weights = np.where(np.abs(scaled) < 1.0, (1.0 - scaled**2) ** 2, 0.0) / deviation_m**2
        information = terms.T @ (weights[:, None] * terms) + prior
        found = np.linalg.solve(information, terms.T @ (weights * heights_m))
        near = (weights > 0.0) & (model_m < noise_m)
        if np.any(near):
            noise_m = max(_MIN_NOISE_M, 1.4826 * float(np.median(np.abs(heights_m - terms @ found)[near])))
    residuals_m = heights_m - terms @ found

    tiles = np.unique(np.floor(places_m / _TILE_M), axis=0, return_inverse=True)[1].reshape(-1)
    scores = np.zeros((tiles.max() + 1, len(expected)))
    np.add.at(scores, tiles, terms * (weights * residuals_m)[:, None])
    spread = np.linalg.inv(information)
    by_biases = terms.T @ (weights[:, None] * _by_biases(places_m, height_m) * bias_sigmas)
    covariance = spread @ (prior + scores.T @ scores + by_biases @ by_biases.T) @ spread
    wheels = np.array([[x, y] for x in (-wheels_m[0], wheels_m[0]) for y in (-wheels_m[1], wheels_m[1])])
    under_wheels = np.column_stack([np.ones(4), wheels])
    to_plane = np.linalg.pinv(under_wheels) @ _terms(wheels)
    uneven_m2 = _UNEVENNESS_M**2 + _unevenness_m2(residuals_m[near], tiles[near])
    covariance = to_plane @ covariance @ to_plane.T + uneven_m2 * np.linalg.inv(under_wheels.T @ under_wheels)

    rise_m, slope_x, slope_y = to_plane @ found
    normal = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(1.0 + slope_x**2 + slope_y**2)
    at_target = np.array([1.0, *target_m[:2]])
    nearness = nearness_of(points_m)
    on_ground = np.maximum(0.0, 1.0 - (residuals_m / (0.3 * distance_m)) ** 2) ** 2
    allowed_m = np.hypot(distance_m, 3.0 * model_m)
    far_below = nearness @ (residuals_m < -_BELOW_DISTANCES * allowed_m) / all_nearness
    seen = nearness * on_ground
    directions = places_m / np.maximum(lengths(points_m[:, :2]), 1e-9)[:, None]
    return GroundSurface(
        normal=read_only(normal @ axes, np.float64),
        offset_m=float(normal[2] * (height_m - rise_m)),
        sigma_z_m=float(np.sqrt(at_target @ covariance @ at_target)),
        sigma_roll_pitch_rad=np.sqrt(np.diag(covariance)[[2, 1]]),
        cells=int(np.count_nonzero(np.abs(residuals_m) <= distance_m)),
        residual_m=float(np.sqrt(weights @ residuals_m**2 / max(weights.sum(), 1e-9))),
        score=float(seen.sum() - nearness @ (residuals_m < -allowed_m)),
        below=float(far_below),
        one_sidedness=float(np.linalg.norm(seen @ directions) / max(seen.sum(), 1e-9)),
    )


def _terms(places_m: FloatArray) -> FloatArray:
    """Return the terms (N, 10) of the Taylor series of third degree at places (N, 2)."""
    x, y = places_m.T
    second = [x**2 / 2.0, x * y, y**2 / 2.0]
    third = [x**3 / 6.0, x**2 * y / 2.0, x * y**2 / 2.0, y**3 / 6.0]
    return np.stack([np.ones_like(x), x, y, *second, *third], axis=1)


def _by_biases(places_m: FloatArray, height_m: float) -> FloatArray:
    """Return (N, 2) how far ground at places (N, 2) appears too high, per metre of range and radian of elevation."""
    flat_m = lengths(places_m)
    return np.stack([-height_m / np.hypot(flat_m, max(height_m, _SENSOR_HEIGHT_M)), flat_m], axis=1)


def _unevenness_m2(residuals_m: FloatArray, tiles: npt.NDArray[np.intp]) -> float:
    """Return the mean square of how far tiles are from the surface, without what noise within them explains."""
    counts = np.bincount(tiles)
    many = counts > 4
    if not np.any(many):
        return 0.0
    counts, sums = np.maximum(counts, 1), np.bincount(tiles, residuals_m)
    within = np.bincount(tiles, residuals_m**2) - sums**2 / counts
    between = (sums / counts) ** 2 - within / np.maximum(counts - 1, 1) / counts
    return max(0.0, float(between[many].mean()))


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
    bias_sigmas = _bias_sigmas(biases, config.refine)
    forward = np.array([1.0, 0.0, 0.0]) if known is None else known.rotation[0]
    wheels_m = _WHEELS_OF_ANY_HEADING_M if known is None else _WHEELS_M
    fitted = (
        fit_surface(
            points_m - middle_m, -middle_m, axes_of(normal, forward), height_m, wheels_m, _DISTANCE_M, bias_sigmas
        )
        for normal, height_m in _planes(points_m - middle_m, config.ground, config.runtime.seed)
    )
    surfaces = [each for each in fitted if each.below <= _MAX_SHARE_BELOW and each.score >= least_score]
    if not surfaces:
        return None, (
            f"no plane lies under the rig: tilted by at most {config.ground.max_tilt_deg:g} deg against the z axis of "
            f"{target}, with nothing below it"
        )
    found = max(surfaces, key=lambda each: each.score)
    if found.cells < _MIN_CELLS:
        return None, f"too little ground is seen: {found.cells} cells of {_CELL_M} m, of which {_MIN_CELLS} are needed"
    offset_m = found.offset_m - float(found.normal @ middle_m)
    a, b, c = found.normal
    x_m, y_m, yaw_rad = (0.0, 0.0, 0.0) if known is None else (*known.xyz_m[:2].tolist(), float(known.rpy_rad[2]))
    roll_pitch_yaw = [np.arctan2(b, c), np.arctan2(-a, np.hypot(b, c)), yaw_rad]
    frame = config.ground.frame if known is None else known.target
    plane = GroundPlane(
        normal=found.normal,
        offset_m=offset_m,
        T_base_target=RigidTransform.from_xyz_rpy(frame, target, [x_m, y_m, offset_m], roll_pitch_yaw),
        inlier_share=found.cells / len(points_m),
        area_m2=found.cells * _CELL_M**2,
        residual_m=found.residual_m,
        sigma_z_m=found.sigma_z_m,
        sigma_roll_pitch_deg=read_only(np.rad2deg(found.sigma_roll_pitch_rad), np.float64),
        doubt=_doubt(found, config.acceptance),
        T_base_target_rig=known,
    )
    return plane, f"{plane.area_m2:.0f} m2 of ground are seen" + (f"; {plane.doubt}" if plane.doubt else "")


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
    share = np.sqrt(nearness)
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
    target: str,
    clouds: Mapping[str, FloatArray],
    poses: Mapping[str, RigidTransform],
    config: CalibrationConfig,
    least_score: float = -np.inf,
) -> RigidTransform | None:
    """Estimate the pose of the target LiDAR in a frame with z up; None without a ground plane.

    Args:
        clouds: per LiDAR (N, 3) in its own frame.
        poses: of the placed LiDARs in the target's frame; empty to use the target alone.
        least_score: of the plane; see `GroundSurface.score`.
    """
    known = poses or {target: RigidTransform.identity(target, target)}
    samples = []
    for name, pose in known.items():
        if (points_m := clouds.get(name)) is not None:
            most = min(_LEVEL_POINTS // len(known), len(points_m))
            rows = np.random.default_rng(0).choice(len(points_m), most, replace=False)
            samples.append(pose.apply(points_m[np.sort(rows)]))
    points_m = np.concatenate([np.empty((0, 3)), *samples])
    ground, _ = estimate_ground(target, points_m, config, middle_of(known), least_score=least_score)
    return None if ground is None else RigidTransform(LEVEL_FRAME, target, ground.T_base_target.matrix)
