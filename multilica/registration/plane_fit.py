# SPDX-License-Identifier: Apache-2.0
"""Point-to-plane fit of a registered pose, with the information of the result."""

from dataclasses import dataclass, replace

import numpy as np

from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform
from multilica.registration.gicp import GicpCloud
from multilica.registration.neighbours import MovedPoints
from multilica.registration.plane_equations import PlaneEquations, members
from multilica.registration.poses import arc_between_m, moved
from multilica.registration.sensor_biases import (
    BIAS_COUNT,
    SCALE,
    posterior,
    ring_numbers,
    ring_sigmas,
    shifts_per_bias,
    shifts_per_ring_bias,
    slopes_per_bias,
)
from multilica.results import BiasInformation, IndexArray

# Three matches per degree of freedom, rounded up.
_MIN_MATCHES = 20

# Points nearer than this to the other cloud constrain the pose; more than this many are thinned evenly.
_DISTANCE_M = 0.2
_MAX_POINTS = 20_000
# Residuals are not taken to be smaller than this.
_MIN_SIGMA_M = 0.005

# A tenth of a millimetre is below the sigma of every placed LiDAR.
_SETTLED_M = 1e-4
_ITERATIONS = 15
# Matches follow their points, so a step of Gauss and Newton goes about half of the way.
_RELAXATION = 1.5

# Least range noise of vehicle LiDARs: no smaller residual is an outlier.
_NOISE_M = 0.01
_MAD_TO_SIGMA = 1.4826
# Half the weight at about twice the usual residual (Geman-McClure).
_OUTLIER_SIGMAS = 3.0
# Size of a car door, a window, a kerb stone: random errors of its points are not independent.
_PATCH_M = 1.0
# Size of a facade, a hedge, a piece of road: one surface of one material, at one angle to the beams.
_SURFACE_M = 6.0
# A surface is not known better: its reflectivity changes a range by millimetres.
_SURFACE_SIGMA_M = 0.002
# Share of the sums of rings that counts, measured on simulated vehicles: their biases and the noise count already.
_OF_RINGS = 0.15
# Below this share, what remains is noise of the matches.
_LEAST_REAL = 0.02

_SCALE = np.repeat([1.0 / LEVER_ARM_M, 1.0], 3)


@dataclass(frozen=True, slots=True, eq=False)
class PlaneFit:
    """A fitted pose.

    Args:
        information: (6, 6) inverse covariance, order rotation (rad), translation (m), both along the target's axes, the
            rotation about the source's origin; the biases of both LiDARs are marginalised. None where too few points
            match.
        biases: of both LiDARs, for a joint estimate.
    """

    pose: RigidTransform
    information: FloatArray | None = None
    biases: BiasInformation | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Overlap:
    """Points of the source near the target: all that can match at or near the registered pose.

    Args:
        points_m, normals: (N, 3) of the source.
        placed: finds their neighbours in the target.
        shifts: (4, N, 3) how biases move them, and `ring_shifts` (3, N, 3) those of their rings.
        surfaces, rings: (N,) number of the surface and of the ring that a point is of; points with one number share
            their errors.
        target_rings: (T,) the same of the target.
    """

    target: GicpCloud
    points_m: FloatArray
    normals: FloatArray
    placed: MovedPoints
    shifts: FloatArray
    ring_shifts: FloatArray
    surfaces: IndexArray
    rings: IndexArray
    target_rings: IndexArray


@dataclass(frozen=True, slots=True, eq=False)
class _Residuals:
    """Distance of M matches to the target's plane, weight, (M, 3) normal, and position in the target's frame.

    `rows` and `index` (M,) are the points of source and target, `arms` the positions from the source's origin, and
    `sigma_m` is the usual residual.
    """

    residual_m: FloatArray
    weight: FloatArray
    normals: FloatArray
    arms: FloatArray
    points_m: FloatArray
    rows: IndexArray
    index: IndexArray
    sigma_m: float

    @property
    def gradient(self) -> FloatArray:
        """(6,) by the pose; the sum of cross products is the antisymmetric part of one matrix product."""
        pulls = self.normals * (self.weight * self.residual_m)[:, None]
        product = self.arms.T @ pulls
        turn = (product - product.T)[[1, 2, 0], [2, 0, 1]]
        return np.concatenate([turn, pulls.sum(axis=0)])

    def jacobian(self, overlap: _Overlap, pose: RigidTransform) -> FloatArray:
        """(M, 14) derivative of the residuals by pose and biases.

        A scale that both LiDARs have in common would shrink the noise with the points, and gain by that alone. The
        target's scale is therefore taken at the point of the source: what they have in common moves the source only.
        """
        in_source = self.normals @ pose.rotation
        by_target = slopes_per_bias(overlap.target.points_m[self.index], self.normals)
        by_target[:, SCALE] = np.einsum("ij,ij->i", self.normals, self.points_m)
        by_source = -np.einsum("ij,kij->ik", in_source, overlap.shifts[:, self.rows])
        (x, y, z), (a, b, c) = self.arms.T, self.normals.T
        turn = np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=1)
        return np.concatenate([turn, self.normals, by_target, by_source], axis=1)

    def by_rings(self, overlap: _Overlap, pose: RigidTransform) -> tuple[FloatArray, FloatArray]:
        """(M, 3) derivatives of the residuals by the biases of the ring of the target, and of that of the source."""
        of_target = shifts_per_ring_bias(overlap.target.points_m[self.index])
        of_source = overlap.ring_shifts[:, self.rows]
        return np.einsum("ij,kij->ik", self.normals, of_target), -np.einsum(
            "ij,kij->ik", self.normals @ pose.rotation, of_source
        )


def fit_planes(
    target: GicpCloud, source: GicpCloud, T_target_source: RigidTransform, bias_sigmas: FloatArray
) -> PlaneFit:
    """Refine a pose by point-to-plane registration (Chen and Medioni, 1992) on planar surroundings only.

    GICP gives every match the same weight, so bushes, edges and single scan lines pull as much as walls. Here a
    match is weighted by the flatness of the target, by the agreement of both normals, and by its residual (Geman and
    McClure, 1985, with the scale from the median residual). The biases of both LiDARs in range, elevation, scale and
    incidence are estimated with the pose, with a prior. Those of their rings follow in one step at the end.

    Args:
        bias_sigmas: (8,) standard deviations of the biases of target and source, as `prior_sigmas` gives them.

    Returns:
        If too few points match, the given pose alone; if the fit moves the pose by more than 0.2 m, the given one.
    """
    overlap = _overlap(target, source, T_target_source)
    pose, biases = T_target_source, np.zeros(2 * BIAS_COUNT)
    for _ in range(_ITERATIONS):
        residuals = _residuals(overlap, pose, biases)
        if residuals is None:
            return PlaneFit(T_target_source)
        jacobian = residuals.jacobian(overlap, pose)
        weighted = jacobian * residuals.weight[:, None]
        scores = members(overlap.surfaces[residuals.rows], residuals.residual_m) @ weighted[:, :6]
        hessian, spread = _floored(
            jacobian.T @ weighted, scores.T @ scores + _noise(jacobian[:, :6].T @ weighted[:, :6])
        )
        variance = _usual_variance(hessian, spread)
        gradient = weighted.T @ residuals.residual_m
        step = posterior(hessian / variance, gradient / variance, biases, bias_sigmas).step * _RELAXATION
        pose, biases = moved(pose, step[:3], step[3:6]), biases + step[6:]
        if np.abs(step[:6] / _SCALE).max() < _SETTLED_M:
            break
    if arc_between_m(pose, T_target_source) > _DISTANCE_M:
        return pose_information(target, source, T_target_source, bias_sigmas)
    return _with_information(overlap, pose, biases, bias_sigmas)


def pose_information(
    target: GicpCloud, source: GicpCloud, T_target_source: RigidTransform, bias_sigmas: FloatArray
) -> PlaneFit:
    """Compute the information (inverse covariance) of a registered pose.

    The covariance is the sandwich H^-1 B H^-1 (White, Econometrica 1980), with B clustered: points of one surface, and
    of one ring of the target or the source, share what the biases leave of their systematic errors. For the random part
    alone, B sums over patches of a metre (Liang and Zeger, Biometrika 1986). H is the Gauss-Newton Hessian, reduced to
    what remains of it when the pose moves by the noise and the points are matched again: matches follow their points,
    so the plain Hessian claims too much.

    Args:
        bias_sigmas: as for `fit_planes`.

    Returns:
        The given pose, without biases, as these are estimated together with a pose only.
    """
    overlap = _overlap(target, source, T_target_source)
    found = _with_information(overlap, T_target_source, np.zeros(2 * BIAS_COUNT), bias_sigmas)
    return replace(found, pose=T_target_source, biases=None)


def _with_information(overlap: _Overlap, pose: RigidTransform, biases: FloatArray, bias_sigmas: FloatArray) -> PlaneFit:
    """Estimate the biases of the rings too, and shift the pose accordingly."""
    residuals = _residuals(overlap, pose, biases)
    if residuals is None:
        return PlaneFit(pose)
    equations, *rings = _equations(overlap, residuals, pose)
    hessian = equations.hessian(residuals.weight)
    by_surfaces, systematic, random = _spreads(overlap, residuals, equations)
    noise = _noise(hessian)
    remaining = _remaining_hessian(overlap, pose, biases, residuals, hessian)
    hessian, spread = _floored(remaining, systematic + noise)
    variance = _usual_variance(hessian, by_surfaces + noise)
    gradient = equations.gradient(residuals.weight * residuals.residual_m) / variance
    of_rings = [
        ring_sigmas(sigmas, len(numbers)) for sigmas, numbers in zip(bias_sigmas.reshape(2, -1), rings, strict=True)
    ]
    sigmas = np.concatenate([bias_sigmas, *of_rings])
    biases = np.concatenate([biases, np.zeros(len(sigmas) - len(bias_sigmas))])
    known = posterior(
        hessian / variance, gradient, biases, sigmas, spread / variance**2, rings=[len(numbers) for numbers in rings]
    )
    of_biases = BiasInformation(
        hessian / variance,
        gradient + hessian @ known.step / variance,
        spread / variance**2,
        (random + (spread - systematic)) / variance**2,
        biases + known.step[6:],
        *rings,
    )
    pose = moved(pose, known.step[:3], known.step[3:6])
    return PlaneFit(pose, np.asarray(np.linalg.pinv(known.covariance, hermitian=True)), of_biases)


def _equations(
    overlap: _Overlap, residuals: _Residuals, pose: RigidTransform
) -> tuple[PlaneEquations, IndexArray, IndexArray]:
    """Return the equations with the numbers of the rings of target and source."""
    of_target, target_rings = np.unique(overlap.target_rings[residuals.index], return_inverse=True)
    of_source, source_rings = np.unique(overlap.rings[residuals.rows], return_inverse=True)
    equations = PlaneEquations(
        residuals.jacobian(overlap, pose),
        residuals.by_rings(overlap, pose),
        (target_rings, source_rings),
        (len(of_target), len(of_source)),
    )
    return equations, of_target, of_source


def _noise(hessian: FloatArray) -> FloatArray:
    """Return the covariance of the sum of scores if all residuals were as small as they can be."""
    return _MIN_SIGMA_M**2 * hessian


def _usual_variance(hessian: FloatArray, spread: FloatArray) -> float:
    """Return the variance of a residual with which the Hessian of the pose would be its information, the median of six.

    Weights by direction would follow the chance with which few surfaces agree.
    """
    values, directions = np.linalg.eigh(hessian[:6, :6] * np.outer(_SCALE, _SCALE))
    whitened = _SCALE[:, None] * directions / np.sqrt(np.maximum(values, 1e-9))
    return float(np.median(np.linalg.eigvalsh(whitened.T @ spread[:6, :6] @ whitened)))


def _spreads(
    overlap: _Overlap, residuals: _Residuals, equations: PlaneEquations
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the covariance (N, N) of the sum of scores: by surfaces, by surfaces and rings, and by random errors.

    Few surfaces tell little of the size of their errors, and the fit hides those that it follows. Therefore half of
    what a surface contributes is its own sum, and half is that of a surface with the usual error.
    """
    labels = overlap.surfaces[residuals.rows]
    pulls = residuals.weight * residuals.residual_m
    sums_m, weights = np.bincount(labels, pulls), np.bincount(labels, residuals.weight)
    usual_m2 = sums_m @ sums_m / (weights @ weights)
    scores, uneven = _squared(equations, labels, pulls), _squared(equations, labels, residuals.weight)
    of_targets, of_sources = (_squared(equations, rings, pulls) for rings in equations.rings)
    by_surfaces = scores + _SURFACE_SIGMA_M**2 * uneven
    systematic = (
        0.5 * (scores + usual_m2 * uneven) + _OF_RINGS * (of_targets + of_sources) + _SURFACE_SIGMA_M**2 * uneven
    )
    return by_surfaces, systematic, _squared(equations, _numbered(np.floor(residuals.points_m / _PATCH_M)), pulls)


def _squared(equations: PlaneEquations, labels: IndexArray, factors: FloatArray) -> FloatArray:
    """Sum the outer products (N, N) of the sums of each label."""
    sums = equations.summed(labels, factors)
    return np.asarray((sums.T @ sums).toarray())


def _overlap(target: GicpCloud, source: GicpCloud, pose: RigidTransform) -> _Overlap:
    """Select the points that may match, thinned evenly to the number allowed."""
    near, *_ = target.tree.nearest_within(pose.apply(source.points_m), 1.5 * _DISTANCE_M)
    if len(near) > _MAX_POINTS:
        near = near[np.linspace(0, len(near) - 1, _MAX_POINTS).astype(np.intp)]
    normals, _ = source.surface.at(near)
    points_m = source.points_m[near]
    placed_m, turned = pose.apply(points_m), pose.rotate(normals)
    surfaces = np.column_stack([np.floor(placed_m / _SURFACE_M), np.argmax(np.abs(turned), axis=1)])
    return _Overlap(
        target,
        points_m,
        normals,
        MovedPoints(target.tree, placed_m),
        shifts_per_bias(points_m, normals),
        shifts_per_ring_bias(points_m),
        _numbered(surfaces),
        ring_numbers(points_m),
        ring_numbers(target.points_m),
    )


def _residuals(
    overlap: _Overlap, pose: RigidTransform, biases: FloatArray, sigma_m: float | None = None
) -> _Residuals | None:
    of_target, of_source = biases[:BIAS_COUNT], biases[BIAS_COUNT:]
    arms = pose.rotate(overlap.points_m - np.tensordot(of_source, overlap.shifts, 1))
    points_m = arms + pose.xyz_m
    distance_m, index = overlap.placed.nearest(points_m)
    matched = np.flatnonzero(distance_m <= _DISTANCE_M)
    if len(matched) < _MIN_MATCHES:
        return None
    arms, points_m, index = arms[matched], points_m[matched], index[matched]
    normals, flatness = overlap.target.surface.at(index)
    found_m = overlap.target.points_m[index]
    residual_m = np.einsum("ij,ij->i", normals, points_m - found_m)
    if np.any(of_target):
        residual_m += slopes_per_bias(found_m, normals) @ of_target
    agreement = np.einsum("ij,ij->i", normals, pose.rotate(overlap.normals[matched]))
    if sigma_m is None:
        sigma_m = max(_NOISE_M, _MAD_TO_SIGMA * float(np.median(np.abs(residual_m))))
    # If the normals of both clouds differ by 20 degrees, a quarter of the weight is lost; at 33 degrees, half.
    root = flatness * agreement**2 / (1.0 + (residual_m / (_OUTLIER_SIGMAS * sigma_m)) ** 2)
    return _Residuals(residual_m, root**2, normals, arms, points_m, matched, index, sigma_m)


def _numbered(columns: FloatArray) -> IndexArray:
    """Number the distinct rows of small whole numbers (N, C), from 0."""
    label = np.zeros(len(columns), dtype=np.int64)
    for column in columns.T:
        label = (label << 16) + column.astype(np.int64)
    return np.asarray(np.unique(label, return_inverse=True)[1])


def _remaining_hessian(
    overlap: _Overlap, pose: RigidTransform, biases: FloatArray, residuals: _Residuals, hessian: FloatArray
) -> FloatArray:
    """Scale the Hessian by the share of it that remains along the principal directions of the pose, from 2 % to all.

    Each step is as long as the usual residual: over shorter ones, single points that change their match dominate. All
    directions lose what the best constrained one loses: the weights of residuals fall as these grow. The residuals have
    that already.
    """
    values, directions = np.linalg.eigh(hessian[:6, :6] * np.outer(_SCALE, _SCALE))
    roots = np.sqrt(np.maximum(values, 1e-9))
    left = np.empty((6, 6))
    for axis, direction in enumerate(directions.T):
        step = residuals.sigma_m * _SCALE * direction
        poses = (moved(pose, sign * step[:3], sign * step[3:]) for sign in (1.0, -1.0))
        around = (_residuals(overlap, each, biases, residuals.sigma_m) for each in poses)
        ahead, behind = (np.zeros(6) if each is None else each.gradient for each in around)
        slope = directions.T @ (_SCALE * (ahead - behind)) / (2.0 * residuals.sigma_m)
        left[:, axis] = slope / (roots * roots[axis])
    shares, mixed = np.linalg.eigh(0.5 * (left + left.T))
    shares = np.clip(shares / max(shares[-1], _LEAST_REAL), _LEAST_REAL, 1.0)
    kept = (mixed * np.sqrt(shares)) @ mixed.T
    scaling = ((directions * roots) @ kept @ (directions / roots).T) * np.outer(1.0 / _SCALE, _SCALE)
    remaining = hessian.copy()
    remaining[:6] = scaling @ remaining[:6]
    remaining[:, :6] = remaining[:, :6] @ scaling.T
    return remaining


def _floored(hessian: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return H and B with a floor: where H is below one point, one point with the largest match distance counts."""
    hessian, spread = hessian.copy(), spread.copy()
    lengths = np.outer(_SCALE, _SCALE)
    values, directions = np.linalg.eigh(hessian[:6, :6] * lengths)
    loose = directions[:, values < 1.0]
    hessian[:6, :6] += (directions * np.maximum(1.0 - values, 0.0)) @ directions.T / lengths
    spread[:6, :6] += _DISTANCE_M**2 * (loose @ loose.T) / lengths
    return hessian, spread
