# SPDX-License-Identifier: Apache-2.0
"""Point-to-plane fit of a registered pose, with the information of the result."""

from dataclasses import dataclass

import numpy as np

from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform
from multilica.registration.gicp import GicpCloud
from multilica.registration.neighbours import MovedPoints
from multilica.registration.poses import arc_between_m, moved

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

# Least range noise of vehicle LiDARs: no smaller residual is an outlier.
_NOISE_M = 0.01
_MAD_TO_SIGMA = 1.4826
# Half the weight at about twice the usual residual (Geman-McClure).
_OUTLIER_SIGMAS = 3.0
# Size of a car door, a window, a kerb stone: one plane with one common error.
_PATCH_M = 1.0
# Below this share, what remains is noise of the matches.
_LEAST_REAL = 0.02

_SCALE = np.repeat([1.0 / LEVER_ARM_M, 1.0], 3)


@dataclass(frozen=True, slots=True, eq=False)
class _Overlap:
    """Points of the source near the target: all that can match at or near the registered pose.

    `placed` finds their neighbours in the target.
    """

    target: GicpCloud
    points_m: FloatArray
    normals: FloatArray
    placed: MovedPoints


@dataclass(frozen=True, slots=True, eq=False)
class _Residuals:
    """Distance of M matches to the target's plane, weight, (M, 3) normal, and position in the target's frame.

    `arms` are the positions from the source's origin, and `sigma_m` is the usual residual.
    """

    residual_m: FloatArray
    weight: FloatArray
    normals: FloatArray
    arms: FloatArray
    points_m: FloatArray
    sigma_m: float

    @property
    def jacobian(self) -> FloatArray:
        """(M, 6) derivative of the residuals."""
        return np.concatenate([np.cross(self.arms, self.normals), self.normals], axis=1)

    @property
    def gradient(self) -> FloatArray:
        """(6,); the sum of cross products is the antisymmetric part of one matrix product."""
        pulls = self.normals * (self.weight * self.residual_m)[:, None]
        product = self.arms.T @ pulls
        turn = (product - product.T)[[1, 2, 0], [2, 0, 1]]
        return np.concatenate([turn, pulls.sum(axis=0)])

    @property
    def hessian(self) -> FloatArray:
        """Gauss-Newton Hessian for fixed matches."""
        jacobian = self.jacobian
        return np.asarray(jacobian.T @ (jacobian * self.weight[:, None]))


def fit_planes(
    target: GicpCloud, source: GicpCloud, T_target_source: RigidTransform
) -> tuple[RigidTransform, FloatArray | None]:
    """Refine a pose by point-to-plane registration (Chen and Medioni, 1992) on planar surroundings only.

    GICP gives every match the same weight, so bushes, edges and single scan lines pull as much as walls. Here a
    match is weighted by the flatness of the target, by the agreement of both normals, and by its residual (Geman and
    McClure, 1985, with the scale from the median residual).

    Returns:
        The pose and its information. If too few points match, the given pose and None; if the fit moves the pose
        by more than 0.2 m, the given one.
    """
    overlap = _overlap(target, source, T_target_source)
    pose = T_target_source
    for _ in range(_ITERATIONS):
        residuals = _residuals(overlap, pose)
        if residuals is None:
            return T_target_source, None
        step = _solved(residuals.hessian, -residuals.gradient)
        pose = moved(pose, step[:3], step[3:])
        if np.abs(step / _SCALE).max() < _SETTLED_M:
            break
    if arc_between_m(pose, T_target_source) > _DISTANCE_M:
        pose = T_target_source
    return pose, _information(overlap, pose)


def pose_information(target: GicpCloud, source: GicpCloud, T_target_source: RigidTransform) -> FloatArray | None:
    """Compute the information (inverse covariance) of a registered pose.

    The covariance is the sandwich H^-1 B H^-1 (White, Econometrica 1980). B sums gradients per patch of surface,
    since the residuals of a patch are correlated (Liang and Zeger, Biometrika 1986). H is the Gauss-Newton Hessian,
    reduced to what remains of it when the pose moves by the noise and the points are matched again: matches follow
    their points, so the plain Hessian claims too much.

    Returns:
        (6, 6), order rotation (rad), translation (m), both along the target's axes, the rotation about the source's
        origin; None where too few points match.
    """
    return _information(_overlap(target, source, T_target_source), T_target_source)


def _information(overlap: _Overlap, pose: RigidTransform) -> FloatArray | None:
    residuals = _residuals(overlap, pose)
    if residuals is None:
        return None
    jacobian = residuals.jacobian
    pulls = jacobian * (residuals.weight * residuals.residual_m)[:, None]
    noise = jacobian * (residuals.weight * _MIN_SIGMA_M)[:, None]
    per_patch = _summed_by_patch(residuals.points_m, pulls)
    hessian = _remaining_hessian(overlap, pose, residuals)
    floored, spread = _floored(hessian, per_patch.T @ per_patch + noise.T @ noise)
    return np.asarray(floored @ np.linalg.pinv(spread, hermitian=True) @ floored)


def _overlap(target: GicpCloud, source: GicpCloud, pose: RigidTransform) -> _Overlap:
    """Select the points that may match, thinned evenly to the number allowed."""
    near, *_ = target.tree.nearest_within(pose.apply(source.points_m), 1.5 * _DISTANCE_M)
    if len(near) > _MAX_POINTS:
        near = near[np.linspace(0, len(near) - 1, _MAX_POINTS).astype(np.intp)]
    normals, _ = source.surface.at(near)
    points_m = source.points_m[near]
    return _Overlap(target, points_m, normals, MovedPoints(target.tree, pose.apply(points_m)))


def _residuals(overlap: _Overlap, pose: RigidTransform, sigma_m: float | None = None) -> _Residuals | None:
    arms = pose.rotate(overlap.points_m)
    points_m = arms + pose.xyz_m
    distance_m, index = overlap.placed.nearest(points_m)
    matched = np.flatnonzero(distance_m <= _DISTANCE_M)
    if len(matched) < _MIN_MATCHES:
        return None
    arms, points_m, index = arms[matched], points_m[matched], index[matched]
    normals, flatness = overlap.target.surface.at(index)
    residual_m = np.einsum("ij,ij->i", normals, points_m - overlap.target.points_m[index])
    agreement = np.einsum("ij,ij->i", normals, pose.rotate(overlap.normals[matched]))
    if sigma_m is None:
        sigma_m = max(_NOISE_M, _MAD_TO_SIGMA * float(np.median(np.abs(residual_m))))
    # If the normals of both clouds differ by 20 degrees, a quarter of the weight is lost; at 33 degrees, half.
    root = flatness * agreement**2 / (1.0 + (residual_m / (_OUTLIER_SIGMAS * sigma_m)) ** 2)
    return _Residuals(residual_m, root**2, normals, arms, points_m, sigma_m)


def _summed_by_patch(points_m: FloatArray, pulls: FloatArray) -> FloatArray:
    x, y, z = np.floor(points_m / _PATCH_M).astype(np.int64).T
    _, patch = np.unique((x << 40) + (y << 20) + z, return_inverse=True)
    return np.stack([np.bincount(patch, weights=column) for column in pulls.T], axis=1)


def _remaining_hessian(overlap: _Overlap, pose: RigidTransform, residuals: _Residuals) -> FloatArray:
    """Scale the Hessian by the share of it that remains along its principal directions, from 2 % to all.

    Each step is as long as the usual residual: over shorter ones, single points that change their match dominate.
    """
    lengths = np.outer(_SCALE, _SCALE)
    values, directions = np.linalg.eigh(residuals.hessian * lengths)
    roots = np.sqrt(np.maximum(values, 1e-9))
    left = np.empty((6, 6))
    for axis, direction in enumerate(directions.T):
        step = residuals.sigma_m * _SCALE * direction
        poses = (moved(pose, sign * step[:3], sign * step[3:]) for sign in (1.0, -1.0))
        around = (_residuals(overlap, each, residuals.sigma_m) for each in poses)
        ahead, behind = (np.zeros(6) if each is None else each.gradient for each in around)
        slope = directions.T @ (_SCALE * (ahead - behind)) / (2.0 * residuals.sigma_m)
        left[:, axis] = slope / (roots * roots[axis])
    shares, mixed = np.linalg.eigh(0.5 * (left + left.T))
    root = directions * roots @ mixed
    return np.asarray((root * np.clip(shares, _LEAST_REAL, 1.0)) @ root.T / lengths)


def _floored(hessian: FloatArray, spread: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return H and B with a floor: where H is below one point, one point with the largest match distance counts."""
    lengths = np.outer(_SCALE, _SCALE)
    values, directions = np.linalg.eigh(hessian * lengths)
    loose = directions[:, values < 1.0]
    floored = (directions * np.maximum(values, 1.0)) @ directions.T
    return floored / lengths, spread + _DISTANCE_M**2 * (loose @ loose.T) / lengths


def _solved(hessian: FloatArray, pull: FloatArray) -> FloatArray:
    """Solve for a Gauss-Newton step, bounded in unconstrained directions."""
    values, directions = np.linalg.eigh(hessian * np.outer(_SCALE, _SCALE))
    values = np.maximum(values, 1e-6 * max(values[-1], 1e-6))
    return np.asarray(_SCALE * (directions @ ((directions.T @ (_SCALE * pull)) / values)))
