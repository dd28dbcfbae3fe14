# SPDX-License-Identifier: Apache-2.0
"""Iterations of the point-to-plane fit, and its start beside poses where only scan lines meet."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from multilica.geometry import FloatArray, RigidTransform, turn_upwards
from multilica.registration.gicp import GicpCloud
from multilica.registration.plane_equations import POSE_SCALE, floored, members, noise_of, usual_variance
from multilica.registration.plane_matches import (
    DISTANCE_M,
    MAX_POINTS,
    Overlap,
    PlaneResiduals,
    find_overlap,
    find_residuals,
)
from multilica.registration.poses import arc_between_m, moved
from multilica.registration.sensor_biases import BIAS_COUNT, posterior_step

# A tenth of a millimetre is below the sigma of every placed LiDAR.
_SETTLED_M = 1e-4
# From such a step on, the prior of the biases stays as it is.
_NEARLY_SETTLED_M = 1e-3
_ITERATIONS = 15
# Matches follow their points, so a step of Gauss and Newton goes about half of the way.
_RELAXATION = 1.5
# LiDARs of 16 rings, 2 degrees apart, were turned by 0.3 to 1.1 degrees; a fit reaches half a degree.
_TURNS_RAD = np.deg2rad([-1.2, -0.6, 0.6, 1.2])
# Usual residuals there were 1.2 to 2 times those at the true pose, and the matches 1.0 to 1.3 times as many.
_SMALLER, _LEAST_MATCHED = 0.9, 0.6
# Points and step, in metres, that are enough to tell where the usual residual is smaller.
_ROUGH_POINTS, _ROUGHLY_SETTLED_M = 2_000, 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class Settled:
    """A pose at which a fit to planes ended.

    Args:
        biases: (8,) of target and source.
        residuals: before the last step.
    """

    overlap: Overlap
    pose: RigidTransform
    biases: FloatArray
    residuals: PlaneResiduals


def settle(
    target: GicpCloud,
    source: GicpCloud,
    T_target_source: RigidTransform,
    bias_sigmas: FloatArray,
    *,
    roughly: bool = False,
) -> Settled | None:
    """Fit a pose to planes from a start, with the biases of both LiDARs.

    Args:
        roughly: with some of the points, to a millimetre.

    Returns:
        None where too few points match.
    """
    most, settled_m = (_ROUGH_POINTS, _ROUGHLY_SETTLED_M) if roughly else (MAX_POINTS, _SETTLED_M)
    overlap = find_overlap(target, source, T_target_source, most)
    pose, biases, prior = T_target_source, np.zeros(2 * BIAS_COUNT), None
    residuals = find_residuals(overlap, pose, biases)
    for _ in range(_ITERATIONS):
        if residuals is None:
            break
        jacobian = residuals.jacobian(overlap, pose)
        weighted = jacobian * residuals.weight[:, None]
        scores = members(overlap.surfaces[residuals.rows], residuals.residual_m) @ weighted[:, :6]
        hessian, spread = floored(
            jacobian.T @ weighted, scores.T @ scores + noise_of(jacobian[:, :6].T @ weighted[:, :6])
        )
        variance = usual_variance(hessian, spread)
        gradient = weighted.T @ residuals.residual_m
        step, used_prior = posterior_step(hessian / variance, gradient / variance, biases, bias_sigmas, prior=prior)
        step = step * _RELAXATION
        pose, biases = moved(pose, step[:3], step[3:6]), biases + step[6:]
        longest_m = np.abs(step[:6] / POSE_SCALE).max()
        if longest_m < settled_m:
            break
        prior = used_prior if roughly or longest_m < _NEARLY_SETTLED_M else None
        residuals = find_residuals(overlap, pose, biases)
    return None if residuals is None else Settled(overlap, pose, biases, residuals)


def settle_beside_lines(target: GicpCloud, source: GicpCloud, first: Settled, bias_sigmas: FloatArray) -> Settled:
    """Return the best of a fit of two LiDARs with few scan lines and of those from poses turned a little.

    Such LiDARs fit in part where their lines meet, not the surfaces. Rough fits tell where to begin.
    """

    def settle_near(start: RigidTransform, *, roughly: bool) -> Settled | None:
        found = settle(target, source, start, bias_sigmas, roughly=roughly)
        return None if found is None or arc_between_m(found.pose, start) > DISTANCE_M else found

    begin, best = first.pose, settle_near(first.pose, roughly=True)
    while best is not None:
        begun = best
        for turned in _turned(begun.pose, source.elevation_axis):
            other = settle_near(turned, roughly=True)
            if other is not None and _is_unlocked(other, best):
                begin, best = turned, other
        if best is begun:
            break
    found = None if begin is first.pose else settle_near(begin, roughly=False)
    return found if found is not None and _is_unlocked(found, first) else first


def _turned(pose: RigidTransform, elevation_axis: FloatArray) -> Iterator[RigidTransform]:
    """Return a pose turned a little about the two axes of the source across which its scan lines lie."""
    here = RigidTransform.identity(pose.source, pose.source)
    for axis in turn_upwards(elevation_axis)[:2]:
        for turn_rad in _TURNS_RAD:
            yield pose @ moved(here, turn_rad * axis, np.zeros(3))


def _is_unlocked(other: Settled, known: Settled) -> bool:
    """Return whether the residuals tell that scan lines, not surfaces, met at the known pose.

    Fewer points have a neighbour where the lines of both LiDARs do not meet.
    """
    some = len(other.residuals.rows) > _LEAST_MATCHED * len(known.residuals.rows)
    return some and other.residuals.sigma_m < _SMALLER * known.residuals.sigma_m
