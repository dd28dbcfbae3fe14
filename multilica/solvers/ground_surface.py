# SPDX-License-Identifier: Apache-2.0
"""A smooth surface that is fitted to the ground under a vehicle."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray, lengths, read_only

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
