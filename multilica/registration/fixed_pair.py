# SPDX-License-Identifier: Apache-2.0
"""Pose and information of a pair without the objects that could have moved between the scans of its LiDARs."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from multilica.geometry import LEVER_ARM_M, FloatArray
from multilica.registration.gicp import GicpCloud
from multilica.registration.poses import moved
from multilica.registration.widening import widened, widened_with_biases
from multilica.results import BoolArray, PairRegistration

# Matches as of the fit to planes; a sample is enough to see which share of them some hold.
_DISTANCE_M = 0.2
_MIN_MATCHES = 20
_SAMPLE = 4000
_NOISE_M = 0.03

# A smaller share of the information is not worth a second look: sigma changes by less than a fifth.
_LEAST_SHARE = 0.3
# A smaller remaining share, near a pose that movable objects chose, may be chance matches, and holds nothing.
_LEAST_LEFT = 0.3
_NOTHING_LEFT = 1e-4
# With a larger standard deviation, what is left does not hold the pose.
_FREE_M = 0.05
# LiDARs that are not synchronised scan up to 0.1 s apart: a car at 110 km/h goes 3 m, any part of it alike.
_MOTION_M = 3.0 / np.sqrt(3.0)
# By so much the direction in which it went is not known: the slope of a road, a curve.
_TURN = 0.01
_SCALE = np.repeat([1.0 / LEVER_ARM_M, 1.0], 3)


@dataclass(frozen=True, slots=True, eq=False)
class _Matches:
    """Normal equations of matches in units of arcs at 10 m: which pose they want, and how firmly.

    Args:
        left: (6, 6) information of fixed objects; `held` (6, 6) that of movable ones.
        fixed_pull, movable_pull: (6,) gradients.
    """

    left: FloatArray
    held: FloatArray
    fixed_pull: FloatArray
    movable_pull: FloatArray


def without_movable(
    pair: PairRegistration,
    clouds: tuple[GicpCloud, GicpCloud],
    on_movable: Callable[[str, FloatArray], BoolArray],
) -> PairRegistration | None:
    """Return the pair with the pose and information that fixed objects give; None if movable ones hold little of it.

    The information that remains is the share of the fixed matches. It is measured with the normals of both clouds,
    once each: their noise, which alone would hold a pose along a plane, then averages out. In directions that fixed
    objects leave free, the pose may be off by the motion of a car.

    Args:
        clouds: of target and source.
        on_movable: tells which points (N, 3) in the frame of a LiDAR or group lie on movable objects.
    """
    found = _match(pair, clouds, on_movable)
    if found is None or pair.information is None:
        return None
    values, directions = np.linalg.eigh(found.left + found.held)
    roots = np.sqrt(np.maximum(values, 1e-3))
    shares, mixed = np.linalg.eigh((directions / roots).T @ found.left @ (directions / roots))
    if shares[0] > 1.0 - _LEAST_SHARE:
        return None
    free = shares < _LEAST_LEFT
    shares = np.where(free, _NOTHING_LEFT, np.minimum(shares, 1.0))
    ahead = (directions / roots) @ mixed
    # The fit by fixed matches alone, as seen from the one by all; what neither knows, such as biases, cancels out.
    by_fixed = np.where(free, 0.0, ahead.T @ found.fixed_pull / shares)
    by_all = np.where(free, 0.0, ahead.T @ (found.fixed_pull + found.movable_pull))
    step = _SCALE * (ahead @ (by_all - by_fixed))
    keep = ((directions * roots) @ mixed * np.sqrt(shares)) @ (directions / roots @ mixed).T
    keep *= np.outer(1.0 / _SCALE, _SCALE)
    pose = moved(pair.T_target_source, step[:3], step[3:])
    return _reduced(replace(pair, T_target_source=pose), keep)


def _match(
    pair: PairRegistration,
    clouds: tuple[GicpCloud, GicpCloud],
    on_movable: Callable[[str, FloatArray], BoolArray],
) -> _Matches | None:
    (target, source), pose = clouds, pair.T_target_source
    rows = np.arange(0, len(source.points_m), max(1, len(source.points_m) // _SAMPLE))
    near, distance_m, index = target.tree.nearest_within(pose.apply(source.points_m[rows]), _DISTANCE_M)
    within = distance_m <= _DISTANCE_M
    rows, index = rows[near[within]], index[within]
    if len(rows) < _MIN_MATCHES:
        return None
    of_target, of_source = target.points_m[index], source.points_m[rows]
    fixed = ~(on_movable(pair.target, of_target) | on_movable(pair.source, of_source))
    if np.all(fixed):
        return None
    normals, flatness = target.surface.at(index)
    others = pose.rotate(source.surface.at(rows)[0])
    agreement = np.einsum("ij,ij->i", normals, others)
    others = np.where(agreement < 0.0, -1.0, 1.0)[:, None] * others
    arms = pose.rotate(of_source)
    residual_m = np.einsum("ij,ij->i", normals, arms + pose.xyz_m - of_target)
    weight = (flatness * agreement**2 / (1.0 + (residual_m / _NOISE_M) ** 2)) ** 2
    one, other = (np.hstack([np.cross(arms, each), each]) * _SCALE for each in (normals, others))
    return _Matches(
        *(_symmetric((one[part] * weight[part, None]).T @ other[part]) for part in (fixed, ~fixed)),
        *(one[part].T @ (weight * residual_m)[part] for part in (fixed, ~fixed)),
    )


def _symmetric(matrix: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (matrix + matrix.T))


def _reduced(pair: PairRegistration, keep: FloatArray) -> PairRegistration:
    """Take information from the pose of a pair, by one factor (6, 6) on both sides; the fit of its biases stays."""
    information = np.asarray(keep @ pair.information @ keep.T)  # type: ignore[operator]
    found, of_biases = pair.bias_information, None
    if found is not None:
        extended = np.eye(len(found.information))
        extended[:6, :6] = keep
        of_biases = replace(
            found.with_spreads_changed(extended),
            information=extended @ found.information @ extended.T,
            # The pose is the best one, and the prior balances the gradient of the biases. The fit's tolerance would
            # move a pose by metres once little holds it.
            gradient=np.concatenate([np.zeros(6), found.gradient[6:]]),
        )
    values, directions = np.linalg.eigh(information * np.outer(_SCALE, _SCALE))
    free = directions.T[values < _FREE_M**-2.0]
    # Over metres the direction turns, and others give way a little.
    steps = [*(_MOTION_M * free), *(_TURN * _MOTION_M * np.eye(6) if len(free) else ())]
    for step in steps:
        information = widened(information, step, 1.0)
        of_biases = None if of_biases is None else widened_with_biases(of_biases, step, 1.0)
    return replace(pair, information=information, bias_information=of_biases)
