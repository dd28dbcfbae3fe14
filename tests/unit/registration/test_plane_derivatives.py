# SPDX-License-Identifier: Apache-2.0
"""Derivatives of the plane fit and the information of its result, against differences and plain sums."""

from functools import partial

import numpy as np
import pytest
from scipy.linalg import eigh

from multilica.config import FineConfig, RefineConfig
from multilica.registration import plane_equations, plane_fit, plane_matches
from multilica.registration.gicp import prepare_gicp_cloud
from multilica.registration.poses import moved
from multilica.registration.sensor_biases import BIAS_COUNT, SCALE, posterior, prior_sigmas, ring_sigmas
from tests.unit.derivatives import TURNS_RAD, assert_alike, derivative, drawn_pose

_BIAS_SIGMAS = np.tile(prior_sigmas("", RefineConfig()), 2)
# Unknowns of a pair: its pose, and the biases of both LiDARs.
_UNKNOWNS = 6 + 2 * BIAS_COUNT


@pytest.fixture(autouse=True)
def wide_matching(monkeypatch):
    """Match points up to 0.3 m apart."""
    for module in (plane_equations, plane_fit, plane_matches):
        monkeypatch.setattr(module, "DISTANCE_M", 0.3)


def _rooms(turn_rad, seed=0):
    """Target, source and true pose: walls of a room metres away from both sensors, points 0.2 m apart."""
    rng = np.random.default_rng(seed)
    ticks = np.arange(0.0, 5.0, 0.2)
    across, up = (axis.ravel() for axis in np.meshgrid(ticks, ticks))
    flat = np.zeros_like(across)
    sides = (np.column_stack(wall) for wall in ((across, up, flat), (flat + 5.2, across, up), (across, flat - 0.2, up)))
    walls_m = np.concatenate(list(sides)) + np.array([3.0, -2.0, 1.0])
    truth = drawn_pose("t", "s", turn_rad, rng)
    source_m = truth.inverse().apply(walls_m + rng.normal(scale=0.01, size=walls_m.shape))
    target, source = (
        prepare_gicp_cloud(name, cloud_m, FineConfig()) for name, cloud_m in (("t", walls_m), ("s", source_m))
    )
    return target, source, truth


def _motions(pose, biases):
    """Return the residuals of the plane fit by a motion of the source, then by the biases of target and source."""
    rest = np.zeros(2 * BIAS_COUNT) if biases is None else biases

    def residuals(overlap, step):
        step = np.concatenate([step, np.zeros(_UNKNOWNS - len(step))])
        return plane_matches.find_residuals(overlap, moved(pose, step[:3], step[3:6]), rest + step[6:])

    return residuals


_BIASES = np.array([0.015, 2e-3, -1e-3, 2e-3, -0.01, -1e-3, 3e-3, -1e-3])


@pytest.mark.parametrize("turn_rad", TURNS_RAD)
@pytest.mark.parametrize("biases", [None, _BIASES], ids=["unbiased", "biased"])
def test_residuals_of_the_plane_fit_by_motions_of_the_source(turn_rad, biases):
    """They are linear in the biases, but for the turned points of the source."""
    target, source, pose = _rooms(turn_rad)
    overlap = plane_matches.find_overlap(target, source, pose)
    residuals = _motions(pose, biases)
    here = residuals(overlap, np.zeros(_UNKNOWNS))
    jacobian = derivative(lambda step: residuals(overlap, step).residual_m, _UNKNOWNS)
    # A scale that both LiDARs have in common moves the source only: it would shrink the noise else.
    jacobian[:, 6 + SCALE] = np.sum(here.normals * here.points_m, axis=1)
    assert_alike(here.jacobian(overlap, pose), jacobian)

    def cost(motion):
        return 0.5 * np.sum(here.weight * residuals(overlap, motion).residual_m ** 2, keepdims=True)

    assert_alike(here.gradient, derivative(cost)[0])


def _clusters(rows):
    members = {}
    for index, row in enumerate(rows):
        members.setdefault(tuple(np.atleast_1d(row)), []).append(index)
    return members.values()


def _summed(rows, clusters):
    return np.array([np.sum(rows[members], axis=0) for members in clusters])


def _by_all_unknowns(target, overlap, here, pose):
    """Derivatives by pose, biases of LiDARs and of rings; bands of elevation of each match, and all bands."""
    dense = here.jacobian(overlap, pose)
    matched_m = (target.points_m[here.index], overlap.points_m[here.rows])
    bands = [np.floor(np.rad2deg(np.arcsin(xyz[:, 2] / np.linalg.norm(xyz, axis=1)))) + 90.0 for xyz in matched_m]
    rings = [np.unique(each) for each in bands]
    of_rings = [
        (part[:, None, :] * (numbers == each[:, None])[:, :, None]).reshape(len(dense), -1)
        for part, each, numbers in zip(here.by_rings(overlap, pose), bands, rings, strict=True)
    ]
    return np.hstack([dense, *of_rings]), bands, rings


def _by_few_surfaces(rows, surfaces):
    """Change (6, 6) of the scores: factors along the principal directions, in which squares of the rows sum to one."""
    lengths_m = np.repeat([0.1, 1.0], 3)
    values, directions = np.linalg.eigh((rows * lengths_m).T @ (rows * lengths_m))
    whitening = lengths_m[:, None] * directions / np.sqrt(values)
    shares = _summed((rows @ whitening) ** 2, surfaces)
    assert np.allclose(shares.sum(axis=0), 1.0)
    return np.linalg.inv(whitening.T) @ np.diag(np.sqrt(1.0 + np.sum(shares**2, axis=0))) @ whitening.T


def _on_pose(spread, change):
    """The spread of the scores times a change (6, 6) of those of the pose."""
    whole = np.eye(len(spread))
    whole[:6, :6] = change
    return whole @ spread @ whole.T


def _surfaces(points_m, normals):
    """Return the surface (N,) of each point: a cell of 6 m with the main axis of the normal."""
    return _clusters(np.column_stack([np.floor(points_m / 6.0), np.argmax(np.abs(normals), axis=1)]))


def _surfaces_and_planes(overlap, here, pose):
    """Return the surface and the plane (N,) of each match: those at equal distances along their normals are one."""
    points_m, normals = pose.apply(overlap.points_m)[here.rows], pose.rotate(overlap.normals)[here.rows]
    from_target_m = np.abs(np.sum(points_m * normals, axis=1))
    planes = np.column_stack([np.floor(from_target_m / 2.0), np.argmax(np.abs(normals), axis=1)])
    return _surfaces(points_m, normals), _clusters(planes)


def _lighter(weight, information, gradient, *spreads):
    return information / weight, gradient / weight, *(each / weight**2 for each in spreads)


@pytest.mark.parametrize("turn_rad", TURNS_RAD)
def test_information_is_that_of_gradients_by_surface_and_ring(turn_rad):
    """H / v of pose and biases, and B / v^2; v is the median variance with which H would be the information.

    B is over cells of 6 m with the main axis, half by their own sums and half by the usual one, over planes that are
    0.9 mm off, over rings of both LiDARs, 0.2 of each, and over patches of 1 m, 0.4 of them. These patches are its
    random part. Directions of n surfaces have 1 + 1 / n times as much. A pair whose variance is larger than its
    information says loses weight.
    """
    target, source, pose = _rooms(turn_rad)
    overlap = plane_matches.find_overlap(target, source, pose)
    here = plane_matches.find_residuals(overlap, pose, _BIASES)
    jacobian, bands, rings = _by_all_unknowns(target, overlap, here, pose)
    pulls = here.weight[:, None] * jacobian
    # The surfaces are those at the pose that the fit began with.
    surfaces, planes = _surfaces_and_planes(overlap, here, pose)

    def squared(clusters, factors=here.residual_m):
        sums = _summed(factors[:, None] * pulls, clusters)
        return sums.T @ sums

    hessian = jacobian.T @ pulls
    noise = 0.005**2 * hessian
    remaining = plane_fit._remaining_hessian(overlap, pose, _BIASES, here.sigma_m, hessian)
    assert np.linalg.eigvalsh(hessian[:6, :6] - remaining[:6, :6]).min() > -1e-6 * np.abs(hessian).max()
    remaining, _ = plane_equations.floored(remaining, noise)
    alike = squared(surfaces, np.ones(len(pulls)))
    uneven = 0.0009**2 * squared(planes, np.ones(len(pulls)))
    variance = np.median(eigh((squared(surfaces) + uneven + noise)[:6, :6], remaining[:6, :6], eigvals_only=True))
    information, gradient = remaining / variance, pulls.T @ here.residual_m / variance
    sigmas = np.concatenate([_BIAS_SIGMAS, *(ring_sigmas(_BIAS_SIGMAS[:4], len(numbers)) for numbers in rings)])
    state = np.concatenate([_BIASES, np.zeros(len(sigmas) - 8)])
    counts = [len(numbers) for numbers in rings]
    first = posterior(information, gradient, state, sigmas, rings=counts)

    left_m = here.residual_m + jacobian @ first.step
    sums_m = _summed(here.weight * left_m, surfaces)
    usual = np.sum(sums_m**2) / np.sum(_summed(here.weight, surfaces) ** 2) * alike
    systematic = 0.5 * (squared(surfaces, left_m) + usual) + uneven
    patches = squared(_clusters(np.floor(here.points_m)), left_m)
    systematic += 0.2 * sum(squared(_clusters(each), left_m) for each in bands) + 0.4 * patches
    wider = _by_few_surfaces(jacobian[:, :6] * np.sqrt(here.weight)[:, None], surfaces)
    few = _on_pose(systematic, wider) - systematic
    random = patches + noise
    spreads = [each / variance**2 for each in (systematic + few + noise, random, few)]
    information, gradient, spread, random, few = plane_fit._weighted(information, gradient, *spreads)
    solve = partial(posterior, information, gradient, state, sigmas, rings=counts, prior=first.prior)
    excess = max(1.0, np.mean(eigh(solve(spread).covariance, solve().covariance, eigvals_only=True)))
    information, gradient, spread, random, few = _lighter(excess, information, gradient, spread, random, few)
    fitted = plane_fit._with_information(overlap, pose, _BIASES, _BIAS_SIGMAS)
    found = fitted.biases
    assert all(map(np.array_equal, (found.target_rings, found.source_rings), rings))
    assert_alike(found.information, information, 1e-5)
    assert_alike(found.spread, spread, 1e-5)
    assert_alike(found.random_spread, random, 1e-5)
    assert_alike(found.few_spread, few, 1e-5)
    known = posterior(information, gradient, state, sigmas, rings=counts)
    assert_alike(found.biases, state + known.step[6:], 1e-5)
    assert np.allclose(fitted.pose.offset_from(moved(pose, known.step[:3], known.step[3:6])), 0.0, atol=1e-8)
    # At the new pose and biases the gradient is that of the prior.
    known = posterior(
        found.information, found.gradient, found.biases, sigmas, found.spread, found.random_spread, counts, known.prior
    )
    assert np.abs(known.step[:6]).max() < 1e-7
    assert_alike(np.linalg.inv(fitted.information), known.covariance, 1e-5)
    assert np.trace(known.repeatability) < np.trace(known.covariance)


def test_a_direction_that_nothing_constrains_counts_as_one_point():
    """Of the scaled Hessian diag(9, 0.25, ...): the second direction becomes 1, with the largest match distance."""
    rng = np.random.default_rng(8)
    directions = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    values = np.array([9.0, 0.25, 0.0, 4.0, 5.0, 6.0])
    # A turn is as long as a shift of 10 m.
    lengths_m = np.array([10.0] * 3 + [1.0] * 3)
    hessian, others = np.eye(9), np.zeros((9, 9))
    hessian[:6, :6] = (directions * values) @ directions.T * np.outer(lengths_m, lengths_m)
    floored, spread = plane_equations.floored(hessian, others)
    assert np.array_equal(floored[6:], np.eye(9)[6:])
    assert not np.any(spread[6:])
    floored, spread = (each[:6, :6] / np.outer(lengths_m, lengths_m) for each in (floored, spread))
    assert_alike(floored, (directions * np.maximum(values, 1.0)) @ directions.T, 1e-9)
    assert_alike(spread, 0.3**2 * directions[:, 1:3] @ directions[:, 1:3].T, 1e-9)
