# SPDX-License-Identifier: Apache-2.0
"""Matches of a source with the planes of a target, and how pose and biases change their residuals."""

from dataclasses import dataclass, replace

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.gicp import GicpCloud
from multilica.registration.neighbours import MovedPoints
from multilica.registration.sensor_biases import (
    BIAS_COUNT,
    SCALE,
    ring_numbers,
    shifts_per_bias,
    shifts_per_ring_bias,
    slopes_per_bias,
)
from multilica.results import IndexArray

DISTANCE_M = 0.2
"""Points nearer than this to the other cloud constrain the pose."""
MAX_POINTS = 20_000
"""More are thinned evenly."""
# Three matches per degree of freedom, rounded up.
_MIN_MATCHES = 20
# Least range noise of vehicle LiDARs: no smaller residual is an outlier.
_NOISE_M = 0.01
_MAD_TO_SIGMA = 1.4826
# Half the weight at about twice the usual residual (Geman-McClure).
_OUTLIER_SIGMAS = 3.0
# Sine of the angle between a beam and a surface above which any normal tells the side: of 16 rings, normals are up to
# 20 degrees off.
_GRAZED = float(np.sin(np.deg2rad(20.0)))
# Size of a facade, a hedge, a piece of road: one surface of one material, at one angle to the beams.
_SURFACE_M = 6.0
# Distance of a plane from the target; a normal that is 2 deg off changes it by as much, 60 m away.
_PLANE_M = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class Overlap:
    """Points of the source near the target: all that can match at or near the registered pose.

    Args:
        points_m, normals: (N, 3) of the source.
        placed: finds their neighbours in the target.
        shifts: (4, N, 3) how biases move them, and `ring_shifts` (3, N, 3) those of their rings.
        sides: (N,) as `sides_of` of these points.
        surfaces, planes, rings: (N,) number of the surface, of the plane and of the ring that a point is of; points
            with one number share their errors.
        target_rings: (T,) the same of the target.
    """

    target: GicpCloud
    points_m: FloatArray
    normals: FloatArray
    placed: MovedPoints
    sides: FloatArray
    shifts: FloatArray
    ring_shifts: FloatArray
    surfaces: IndexArray
    planes: IndexArray
    rings: IndexArray
    target_rings: IndexArray

    def every(self, nth: int) -> "Overlap":
        """Return every nth point."""
        some = slice(None, None, nth)
        return replace(
            self,
            points_m=self.points_m[some],
            normals=self.normals[some],
            placed=self.placed.subset(some),
            sides=self.sides[some],
            shifts=self.shifts[:, some],
            ring_shifts=self.ring_shifts[:, some],
            surfaces=self.surfaces[some],
            planes=self.planes[some],
            rings=self.rings[some],
        )


@dataclass(frozen=True, slots=True, eq=False)
class PlaneResiduals:
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

    def jacobian(self, overlap: Overlap, pose: RigidTransform) -> FloatArray:
        """(M, 14) derivative of the residuals by pose and biases.

        A scale that both LiDARs have in common would shrink the noise with the points, and gain by that alone. The
        target's scale is therefore taken at the point of the source: what they have in common moves the source only.
        """
        in_source = self.normals @ pose.rotation
        by_target = slopes_per_bias(overlap.target.points_m[self.index], self.normals, overlap.target.elevation_axis)
        by_target[:, SCALE] = np.einsum("ij,ij->i", self.normals, self.points_m)
        by_source = -np.einsum("ij,kij->ik", in_source, overlap.shifts[:, self.rows])
        (x, y, z), (a, b, c) = self.arms.T, self.normals.T
        turn = np.stack([y * c - z * b, z * a - x * c, x * b - y * a], axis=1)
        return np.concatenate([turn, self.normals, by_target, by_source], axis=1)

    def by_rings(self, overlap: Overlap, pose: RigidTransform) -> tuple[FloatArray, FloatArray]:
        """(M, 3) derivatives of the residuals by the biases of the ring of the target, and of that of the source."""
        of_target = shifts_per_ring_bias(overlap.target.points_m[self.index], overlap.target.elevation_axis)
        of_source = overlap.ring_shifts[:, self.rows]
        return np.einsum("ij,kij->ik", self.normals, of_target), -np.einsum(
            "ij,kij->ik", self.normals @ pose.rotation, of_source
        )


def find_overlap(target: GicpCloud, source: GicpCloud, pose: RigidTransform, max_points: int = MAX_POINTS) -> Overlap:
    """Select the points that may match; more than so many are thinned evenly."""
    near, *_ = target.tree.nearest_within(pose.apply(source.points_m), 1.5 * DISTANCE_M)
    if len(near) > max_points:
        near = near[np.linspace(0, len(near) - 1, max_points).astype(np.intp)]
    normals, flatness = source.surface.at(near)
    points_m = source.points_m[near]
    placed_m, turned = pose.apply(points_m), pose.rotate(normals)
    axes = np.argmax(np.abs(turned), axis=1)
    offsets_m = np.abs(np.einsum("ij,ij->i", placed_m, turned))
    return Overlap(
        target,
        points_m,
        normals,
        MovedPoints.of(target.tree, placed_m),
        sides_of(normals, points_m, flatness),
        shifts_per_bias(points_m, normals, source.elevation_axis),
        shifts_per_ring_bias(points_m, source.elevation_axis),
        numbered(np.column_stack([np.floor(placed_m / _SURFACE_M), axes])),
        numbered(np.column_stack([np.floor(offsets_m / _PLANE_M), axes])),
        ring_numbers(points_m, source.elevation_axis),
        ring_numbers(target.points_m, target.elevation_axis),
    )


def find_residuals(
    overlap: Overlap, pose: RigidTransform, biases: FloatArray, sigma_m: float | None = None
) -> PlaneResiduals | None:
    """Match the points of an overlap at a pose, with the biases (8,) of target and source taken off.

    Args:
        sigma_m: the usual residual; None: that of these matches.

    Returns:
        None where too few match.
    """
    of_target, of_source = biases[:BIAS_COUNT], biases[BIAS_COUNT:]
    arms = pose.rotate(overlap.points_m - np.tensordot(of_source, overlap.shifts, 1))
    points_m = arms + pose.xyz_m
    distance_m, index = overlap.placed.nearest(points_m)
    matched = np.flatnonzero(distance_m <= DISTANCE_M)
    if len(matched) < _MIN_MATCHES:
        return None
    arms, points_m, index = arms[matched], points_m[matched], index[matched]
    normals, flatness = overlap.target.surface.at(index)
    found_m = overlap.target.points_m[index]
    residual_m = np.einsum("ij,ij->i", normals, points_m - found_m)
    if np.any(of_target):
        residual_m += slopes_per_bias(found_m, normals, overlap.target.elevation_axis) @ of_target
    agreement = np.einsum("ij,ij->i", normals, pose.rotate(overlap.normals[matched]))
    agreement[agreement * sides_of(normals, found_m, flatness) * overlap.sides[matched] < 0.0] = 0.0
    if sigma_m is None:
        sigma_m = max(_NOISE_M, _MAD_TO_SIGMA * float(np.median(np.abs(residual_m))))
    # If the normals of both clouds differ by 20 degrees, a quarter of the weight is lost; at 33 degrees, half.
    root = flatness * agreement**2 / (1.0 + (residual_m / (_OUTLIER_SIGMAS * sigma_m)) ** 2)
    return PlaneResiduals(residual_m, root**2, normals, arms, points_m, matched, index, sigma_m)


def sides_of(normals: FloatArray, points_m: FloatArray, flatness: FloatArray) -> FloatArray:
    """Return on which side of its surface (N,) the sensor at the origin sees each point: 1, -1, or 0 if it grazes it.

    Sensors that see a post or a sign from opposite sides share no surface: its sides are as far apart as it is thick.
    The normal of a surface is off by about its thickness over its extent, which is one less the flatness; by twice
    that, it tells the side.
    """
    across_m = np.einsum("ij,ij->i", normals, points_m)
    off = np.minimum(2.0 * (1.0 - flatness), _GRAZED)
    grazed = np.abs(across_m) < off * np.linalg.norm(points_m, axis=1)
    return np.where(grazed, 0.0, np.sign(across_m))


def numbered(columns: FloatArray) -> IndexArray:
    """Number the distinct rows of small whole numbers (N, C), from 0."""
    label = np.zeros(len(columns), dtype=np.int64)
    for column in columns.T:
        label = (label << 16) + column.astype(np.int64)
    return np.asarray(np.unique(label, return_inverse=True)[1])
