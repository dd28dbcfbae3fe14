# SPDX-License-Identifier: Apache-2.0
"""Point-to-plane fit of a registered pose, with the information of the result."""

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.gicp import GicpCloud
from multilica.registration.plane_equations import (
    POSE_SCALE,
    PlaneEquations,
    floored,
    members,
    noise_of,
    usual_variance,
)
from multilica.registration.plane_matches import (
    DISTANCE_M,
    Overlap,
    PlaneResiduals,
    find_overlap,
    find_residuals,
    numbered,
)
from multilica.registration.plane_settling import settle, settle_beside_lines
from multilica.registration.poses import arc_between_m, moved
from multilica.registration.sensor_biases import BIAS_COUNT, posterior, posterior_step, ring_sigmas
from multilica.results import BiasInformation, IndexArray

# About as many tell how the gradient changes with the pose.
_SLOPE_POINTS = 4_000

# Size of a car door, a window, a kerb stone: random errors of its points are not independent.
_PATCH_M = 1.0
# Patches of one surface are not independent either, measured on simulated vehicles: their sums count so much more.
_OF_PATCHES = 0.4
# A plane is not known better: it is of one material, whose reflectivity changes a range by millimetres.
_PLANE_SIGMA_M = 0.0009
# The variance of a direction that n surfaces constrain is larger by this over n.
_OF_FEW = 1.0
# Share of the sums of rings that counts, measured on simulated vehicles: their biases and the noise count already.
_OF_RINGS = 0.2
# Below this share, what remains is noise of the matches.
_LEAST_REAL = 0.02


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


def fit_planes(
    target: GicpCloud, source: GicpCloud, T_target_source: RigidTransform, bias_sigmas: FloatArray
) -> PlaneFit:
    """Refine a pose by point-to-plane registration (Chen and Medioni, 1992) on planar surroundings only.

    GICP gives every match the same weight, so bushes, edges and single scan lines pull as much as walls. Here a
    match is weighted by the flatness of the target, by the agreement of both normals, and by its residual (Geman and
    McClure, 1985, with the scale from the median residual). The biases of both LiDARs in range, elevation, scale and
    incidence are estimated with the pose, with a prior. Those of their rings follow in one step at the end.

    Two LiDARs with few scan lines fit in part where these lines meet, turned by up to half the angle between them. Such
    a fit is begun at poses turned a little, too; the residuals are smaller at the true pose by a fifth or more.

    Args:
        bias_sigmas: (8,) standard deviations of the biases of target and source, as `prior_sigmas` gives them.

    Returns:
        If too few points match, the given pose alone; if the fit moves the pose by more than 0.2 m, the given one.
    """
    first = settle(target, source, T_target_source, bias_sigmas)
    if first is None:
        return PlaneFit(T_target_source)
    best = settle_beside_lines(target, source, first, bias_sigmas) if target.is_sparse and source.is_sparse else first
    if best is first and arc_between_m(best.pose, T_target_source) > DISTANCE_M:
        return pose_information(target, source, T_target_source, bias_sigmas)
    return _with_information(best.overlap, best.pose, best.biases, bias_sigmas)


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
    overlap = find_overlap(target, source, T_target_source)
    found = _with_information(overlap, T_target_source, np.zeros(2 * BIAS_COUNT), bias_sigmas)
    return replace(found, pose=T_target_source, biases=None)


def _with_information(overlap: Overlap, pose: RigidTransform, biases: FloatArray, bias_sigmas: FloatArray) -> PlaneFit:
    """Estimate the biases of the rings too, and shift the pose accordingly.

    The spread is that of the residuals which these leave. With it, directions in which the surfaces contradict each
    other lose weight, so that other pairs and snapshots decide them. The pair as a whole loses weight if its variance
    is larger than its information says; the prior of the biases is then found once more.
    """
    residuals = find_residuals(overlap, pose, biases)
    if residuals is None:
        return PlaneFit(pose)
    equations, target_rings, source_rings = _equations(overlap, residuals, pose)
    rings = target_rings, source_rings
    hessian = equations.hessian(residuals.weight)
    noise = noise_of(hessian)
    remaining = _remaining_hessian(overlap, pose, biases, residuals.sigma_m, hessian)
    rows = residuals.rows
    surfaces = _Surfaces(equations, overlap.surfaces[rows], overlap.planes[rows], residuals.weight)
    hessian, _ = floored(remaining, noise)
    variance = usual_variance(hessian, surfaces.squared(residuals.residual_m) + surfaces.least + noise)
    gradient = equations.gradient(residuals.weight * residuals.residual_m) / variance
    of_rings = [
        ring_sigmas(sigmas, len(numbers)) for sigmas, numbers in zip(bias_sigmas.reshape(2, -1), rings, strict=True)
    ]
    sigmas = np.concatenate([bias_sigmas, *of_rings])
    biases = np.concatenate([biases, np.zeros(len(sigmas) - len(bias_sigmas))])
    counts = [len(numbers) for numbers in rings]
    first_step, first_prior = posterior_step(hessian / variance, gradient, biases, sigmas, counts)

    left_m = residuals.residual_m + equations.changes(first_step)
    patches = numbered(np.floor(residuals.points_m / _PATCH_M))
    random = _squared(equations, patches, residuals.weight * left_m)
    systematic = surfaces.spread(left_m) + _OF_PATCHES * random
    few = surfaces.of_few(systematic)
    hessian, spread = floored(remaining, systematic + few + noise)
    random += spread - systematic - few
    information, gradient, spread, random, few = _weighted(
        hessian / variance, gradient, *(each / variance**2 for each in (spread, random, few))
    )
    solved = partial(posterior, biases=biases, sigmas=sigmas, rings=counts, prior=first_prior)
    excess = _excess(solved(information, gradient).covariance, solved(information, gradient, spread=spread).covariance)
    information, gradient = information / excess, gradient / excess
    spread, random, few = (each / excess**2 for each in (spread, random, few))
    known = posterior(information, gradient, biases, sigmas, spread, random, counts, begin=first_prior)
    gradient, biases = gradient + information @ known.step, biases + known.step[6:]
    of_biases = BiasInformation(information, gradient, spread, random, biases, target_rings, source_rings, few)
    pose = moved(pose, known.step[:3], known.step[3:6])
    return PlaneFit(pose, np.asarray(np.linalg.pinv(known.covariance, hermitian=True)), of_biases)


def _excess(expected: FloatArray, found: FloatArray) -> float:
    """Return how many times larger the variance of a pose is than its information says: the mean of six directions.

    It is at least 1. The surfaces can contradict each other in what they say of the biases too.
    """
    return max(1.0, float(np.trace(np.linalg.solve(expected, found))) / len(expected))


def _weighted(
    information: FloatArray, gradient: FloatArray, spread: FloatArray, *parts: FloatArray
) -> tuple[FloatArray, ...]:
    """Weaken the equations of the pose along its principal directions whose spread is above their information.

    This is the weight of the generalised method of moments (Hansen, Econometrica 1982), of the pose given the biases.
    Directions with less spread gain none: few surfaces agree by chance.

    Args:
        parts: of the spread.

    Returns:
        The same, after that.
    """
    scaling = np.outer(POSE_SCALE, POSE_SCALE)
    values, directions = np.linalg.eigh(information[:6, :6] * scaling)
    roots = np.sqrt(np.maximum(values, 1e-9))
    half, whitening = (directions * roots) @ directions.T, (directions / roots) @ directions.T
    excess, axes = np.linalg.eigh(whitening @ (spread[:6, :6] * scaling) @ whitening)
    kept = half @ ((axes / np.maximum(excess, 1.0)) @ axes.T) @ whitening * np.outer(1.0 / POSE_SCALE, POSE_SCALE)
    by_bias = (
        np.linalg.solve(information[:6, :6] * scaling, information[:6, 6:] * POSE_SCALE[:, None]) * POSE_SCALE[:, None]
    )
    change = np.eye(len(gradient))
    change[:6, :6] = kept
    change[6:, :6] = by_bias.T @ (kept - np.eye(6))
    weaker = change @ information
    return 0.5 * (weaker + weaker.T), change @ gradient, *(change @ each @ change.T for each in (spread, *parts))


def _equations(
    overlap: Overlap, residuals: PlaneResiduals, pose: RigidTransform
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


@dataclass(frozen=True, eq=False)
class _Surfaces:
    """Sums over the surfaces (M,) of the matches and over their planes (M,), with weights (M,)."""

    equations: PlaneEquations
    labels: IndexArray
    planes: IndexArray
    weight: FloatArray

    @cached_property
    def _alike(self) -> FloatArray:
        """(N, N) sum of squares if the residuals of each surface were one, the same for all."""
        return _squared(self.equations, self.labels, self.weight)

    @property
    def least(self) -> FloatArray:
        """(N, N) covariance of the sum of scores if each plane was as well known as it can be."""
        return _PLANE_SIGMA_M**2 * _squared(self.equations, self.planes, self.weight)

    def squared(self, residual_m: FloatArray) -> FloatArray:
        return _squared(self.equations, self.labels, self.weight * residual_m)

    def spread(self, residual_m: FloatArray) -> FloatArray:
        """Return the covariance (N, N) of the sum of scores by surfaces and rings.

        Few surfaces tell little of the size of their errors, and the fit hides those that it follows. Therefore half of
        what a surface contributes is its own sum, and half is that of a surface with the usual error.
        """
        pulls = self.weight * residual_m
        sums_m, weights = np.bincount(self.labels, pulls), np.bincount(self.labels, self.weight)
        squares = weights @ weights
        usual = sums_m @ sums_m / squares * self._alike
        of_rings = sum(_squared(self.equations, rings, pulls) for rings in self.equations.rings)
        return np.asarray(0.5 * (self.squared(residual_m) + usual) + _OF_RINGS * of_rings + self.least)

    def of_few(self, spread: FloatArray) -> FloatArray:
        """Return by how much a spread (N, N) grows because few surfaces constrain a direction of the pose.

        It grows like the variance of Student's distribution.
        """
        rows = self.equations.jacobian[:, :6] * np.sqrt(self.weight)[:, None]
        values, directions = np.linalg.eigh((rows.T @ rows) * np.outer(POSE_SCALE, POSE_SCALE))
        roots = np.sqrt(np.maximum(values, 1e-9))
        parts = (rows @ (POSE_SCALE[:, None] * directions / roots)) ** 2
        shares = members(self.labels, np.ones(len(self.labels))) @ parts
        factors = np.sqrt(1.0 + _OF_FEW * np.sum(shares**2, axis=0))
        widening = np.eye(len(spread))
        widening[:6, :6] = (
            (directions * roots * factors) @ (directions / roots).T * np.outer(1.0 / POSE_SCALE, POSE_SCALE)
        )
        return np.asarray(widening @ spread @ widening.T - spread)


def _squared(equations: PlaneEquations, labels: IndexArray, factors: FloatArray) -> FloatArray:
    """Sum the outer products (N, N) of the sums of each label."""
    sums = equations.summed(labels, factors)
    return np.asarray((sums.T @ sums).toarray())


def _remaining_hessian(
    overlap: Overlap, pose: RigidTransform, biases: FloatArray, sigma_m: float, hessian: FloatArray
) -> FloatArray:
    """Scale the Hessian by the share of it that remains along the principal directions of the pose, from 2 % to all.

    Each step is as long as the usual residual: over shorter ones, single points that change their match dominate. All
    directions lose what the best constrained one loses: the weights of residuals fall as these grow. The residuals have
    that already. Some of the points are enough to tell.
    """
    nth = 1 + len(overlap.points_m) // _SLOPE_POINTS
    overlap = overlap.every(nth)
    values, directions = np.linalg.eigh(hessian[:6, :6] * np.outer(POSE_SCALE, POSE_SCALE) / nth)
    roots = np.sqrt(np.maximum(values, 1e-9))
    left = np.empty((6, 6))
    for axis, direction in enumerate(directions.T):
        step = sigma_m * POSE_SCALE * direction
        poses = (moved(pose, sign * step[:3], sign * step[3:]) for sign in (1.0, -1.0))
        around = (find_residuals(overlap, each, biases, sigma_m) for each in poses)
        ahead, behind = (np.zeros(6) if each is None else each.gradient for each in around)
        slope = directions.T @ (POSE_SCALE * (ahead - behind)) / (2.0 * sigma_m)
        left[:, axis] = slope / (roots * roots[axis])
    shares, mixed = np.linalg.eigh(0.5 * (left + left.T))
    shares = np.clip(shares / max(shares[-1], _LEAST_REAL), _LEAST_REAL, 1.0)
    kept = (mixed * np.sqrt(shares)) @ mixed.T
    scaling = ((directions * roots) @ kept @ (directions / roots).T) * np.outer(1.0 / POSE_SCALE, POSE_SCALE)
    remaining = hessian.copy()
    remaining[:6] = scaling @ remaining[:6]
    remaining[:, :6] = remaining[:, :6] @ scaling.T
    return remaining
