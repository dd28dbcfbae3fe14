# SPDX-License-Identifier: Apache-2.0
"""Pose and information of a pair without the objects that could have moved between the scans of its LiDARs."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from multilica.config import FineConfig
from multilica.geometry import LEVER_ARM_M, FloatArray, RigidTransform
from multilica.registration.gicp import GicpCloud, fitness_and_rmse, prepare_gicp_cloud, register
from multilica.registration.plane_fit import fit_planes
from multilica.registration.poses import arc_between_m, is_distinct, moved
from multilica.registration.widening import widened_along
from multilica.results import BoolArray, PairRegistration

# Matches as of the fit to planes; a sample is enough to see which share of them movable objects hold.
_DISTANCE_M = 0.2
_MIN_MATCHES = 20
_SAMPLE = 4000
_NOISE_M = 0.03

# With a smaller share of the information, moved objects are outliers of the fit by all points.
_LEAST_SHARE = 0.1
# With a larger one, fixed objects need not agree with the pose: GICP finds their own. The place where the movable ones
# were in the other scan is sought too, in steps that a registration bridges.
_HELD_SHARE = 0.5
_STEPS_M = (0.75, 1.5, 2.25, 3.0)
# Poses whose shares of matched points differ by less fit as well.
_ALIKE = 0.01
# So few points, and steps that may still be so long, show where a registration ends.
_ROUGH_POINTS = 4000
_ROUGH_STEP = 1e-3
# A pose that fixed objects do not hold at all keeps as much of its information.
_NOTHING_LEFT = 1e-4
# With a larger standard deviation, what is left does not hold the pose.
_FREE_M = 0.05
# LiDARs that are not synchronised scan up to 0.1 s apart: a car at 110 km/h goes 3 m, any part of it alike.
_FARTHEST_M = 3.0
_MOTION_M = _FARTHEST_M / np.sqrt(3.0)
# A direction is free with half of that, if it turns a little against a free one.
_FREED_M = 0.5 * _MOTION_M
# By so much the direction in which it went is not known: the slope of a road, a curve.
_TURN = 0.01
_SCALE = np.repeat([1.0 / LEVER_ARM_M, 1.0], 3)


@dataclass(frozen=True, eq=False)
class PartlyFixedCloud:
    """A LiDAR or a group, and which of its points lie on fixed objects.

    Args:
        is_fixed: (N,) per point of the cloud.
        config: of all registrations; the same for both clouds of a pair.
    """

    cloud: GicpCloud
    is_fixed: BoolArray
    config: FineConfig

    @cached_property
    def fixed(self) -> GicpCloud:
        """The cloud of fixed objects alone."""
        cloud = self.cloud
        return prepare_gicp_cloud(cloud.name, cloud.points_m[self.is_fixed], self.config, cloud.elevation_axis)

    @cached_property
    def few(self) -> GicpCloud:
        """Some points of `fixed`, enough to find where a registration ends."""
        few_points = self.config.model_copy(update={"max_points": _ROUGH_POINTS})
        fixed = self.fixed
        return prepare_gicp_cloud(fixed.name, fixed.points_m, few_points, fixed.elevation_axis)


def without_movable(
    pair: PairRegistration,
    clouds: tuple[PartlyFixedCloud, PartlyFixedCloud],
    bias_sigmas: FloatArray,
) -> PairRegistration | None:
    """Register a pair to fixed objects only; None if movable ones hold little of its pose.

    The registration begins anew if movable objects hold most of the pose: the fit by all points drops matches that
    contradict it, which are those of the fixed objects if the movable ones moved. In directions that fixed objects
    leave free, the pose may be off by the motion of a car.

    Args:
        clouds: of target and source.
        bias_sigmas: as for `fit_planes`.
    """
    shares, directions = _movable_shares(pair, clouds)
    if pair.information is None or shares[0] < _LEAST_SHARE:
        return None
    nothing = replace(pair, information=_NOTHING_LEFT * pair.information, bias_information=None)
    if min(np.count_nonzero(each.is_fixed) for each in clouds) < _MIN_MATCHES:
        return _free(nothing)
    (target, source), config = (each.fixed for each in clouds), clouds[0].config
    first = register(target, source, pair.T_target_source, config) if shares[0] >= _HELD_SHARE else pair
    fit = fit_planes(target, source, first.T_target_source, bias_sigmas)
    if fit.information is None or arc_between_m(fit.pose, pair.T_target_source) > _FARTHEST_M:
        return _free(nothing)
    of_biases = None if pair.bias_information is None else fit.biases
    found = replace(pair, T_target_source=fit.pose, information=fit.information, bias_information=of_biases)
    freed = np.asarray(_free(found).information)
    for direction in directions[shares >= _HELD_SHARE]:
        if _sigma_along(fit.information, direction) >= _FREE_M and _sigma_along(freed, direction) > _FREED_M:
            continue
        other = _other_end(target, clouds[1], pair.T_target_source, first, direction, config)
        if other is not None:
            off = other.offset_from(fit.pose) / _SCALE
            found = widened_along(found, off / np.linalg.norm(off), float(np.linalg.norm(off)))
    return _free(found)


def _other_end(
    target: GicpCloud,
    source: PartlyFixedCloud,
    pose: RigidTransform,
    first: PairRegistration,
    direction: FloatArray,
    config: FineConfig,
) -> RigidTransform | None:
    """Register from where a car that holds the pose could have been; return a pose that fits as well, if there is one.

    A registration reaches a metre, and an object may have moved farther: the pose of what stands still is then beyond.
    Few points decide between them, so the pose stays with what is found from it. One other is enough: the direction is
    then free. Some of the source's points are enough to find it.

    Args:
        first: the registration from the pose.
        direction: (6,) that movable objects hold, as arcs at 10 m.
    """
    rough = config.model_copy(update=dict.fromkeys(("translation_epsilon_m", "rotation_epsilon_rad"), _ROUGH_STEP))
    for metres in (side * step_m for step_m in _STEPS_M for side in (1.0, -1.0)):
        start = moved(pose, *np.split(metres * _SCALE * direction, 2))
        end = register(target, source.few, start, rough).T_target_source
        if is_distinct(end, [first.T_target_source]):
            fitness, *_ = fitness_and_rmse(target, source.fixed, end, config.fitness_distance_m)
            if fitness > (1.0 - _ALIKE) * first.fitness:
                return end
    return None


def _sigma_along(information: FloatArray, direction: FloatArray) -> float:
    """Return the standard deviation along a unit direction (6,), as arcs at 10 m."""
    covariance = np.linalg.pinv(information * np.outer(_SCALE, _SCALE), hermitian=True)
    return float(np.sqrt(direction @ covariance @ direction))


def _movable_shares(
    pair: PairRegistration, clouds: tuple[PartlyFixedCloud, PartlyFixedCloud]
) -> tuple[FloatArray, FloatArray]:
    """Return the shares (6,) of the information that movable objects give, the largest first, and where.

    The directions (6, 6) are rows, as arcs at 10 m.

    The information is measured with the normals of both clouds, once each: their noise, which alone would hold a pose
    along a plane, then averages out.
    """
    (target, source), pose = (each.cloud for each in clouds), pair.T_target_source
    rows = np.arange(0, len(source.points_m), max(1, len(source.points_m) // _SAMPLE))
    near, distance_m, index = target.tree.nearest_within(pose.apply(source.points_m[rows]), _DISTANCE_M)
    within = distance_m <= _DISTANCE_M
    rows, index = rows[near[within]], index[within]
    is_fixed = clouds[0].is_fixed[index] & clouds[1].is_fixed[rows]
    if len(rows) < _MIN_MATCHES or np.all(is_fixed):
        return np.zeros(6), np.eye(6)
    of_target, of_source = target.points_m[index], source.points_m[rows]
    normals, flatness = target.surface.at(index)
    others = pose.rotate(source.surface.at(rows)[0])
    agreement = np.einsum("ij,ij->i", normals, others)
    others = np.where(agreement < 0.0, -1.0, 1.0)[:, None] * others
    arms = pose.rotate(of_source)
    residual_m = np.einsum("ij,ij->i", normals, arms + pose.xyz_m - of_target)
    weight = (flatness * agreement**2 / (1.0 + (residual_m / _NOISE_M) ** 2)) ** 2
    one, other = (np.hstack([np.cross(arms, each), each]) * _SCALE for each in (normals, others))
    left, whole = (
        _symmetric((one[part] * weight[part, None]).T @ other[part]) for part in (is_fixed, np.ones_like(is_fixed))
    )
    values, directions = np.linalg.eigh(whole)
    axes = directions / np.sqrt(np.maximum(values, 1e-3))
    shares, mixed = np.linalg.eigh(axes.T @ left @ axes)
    found = (axes @ mixed).T
    return 1.0 - shares, found / np.linalg.norm(found, axis=1, keepdims=True)


def _symmetric(matrix: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (matrix + matrix.T))


def _free(pair: PairRegistration) -> PairRegistration:
    """Let the pose move like a car along the directions that little holds."""
    values, directions = np.linalg.eigh(np.asarray(pair.information) * np.outer(_SCALE, _SCALE))
    free = directions.T[values < _FREE_M**-2.0]
    # Over metres the direction turns, and others give way a little.
    steps = [*free, *(_TURN * np.eye(6) if len(free) else ())]
    for step in steps:
        length = float(np.linalg.norm(step))
        pair = widened_along(pair, step / length, length * _MOTION_M)
    return pair
