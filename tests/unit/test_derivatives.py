# SPDX-License-Identifier: Apache-2.0
"""Each derivative against central differences, at large rotations and levers of metres."""

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from multilica.config import FineConfig, RefineConfig, StillnessConfig
from multilica.geometry import LEVER_ARM_M, RigidTransform
from multilica.registration import plane_fit
from multilica.registration.gicp import prepare_gicp_cloud
from multilica.registration.poses import arc_between_m, moved
from multilica.registration.sensor_biases import BIAS_COUNT, SCALE, posterior, prior_sigmas, ring_sigmas
from multilica.results import BiasInformation, PairRegistration
from multilica.results.visibility_score import VisibilityScore
from multilica.stages import refine, stillness

_STEP = 1e-5
_TURNS_RAD = (0.1, 1.0, 2.0, 3.0)
_CONFIG = RefineConfig()
_BIAS_SIGMAS = np.tile(prior_sigmas("", _CONFIG), 2)
# Unknowns of a pair: its pose, and the biases of both LiDARs.
_UNKNOWNS = 6 + 2 * BIAS_COUNT


@pytest.fixture(autouse=True)
def wide_matching(monkeypatch):
    """Match points up to 0.3 m apart."""
    monkeypatch.setattr(plane_fit, "_DISTANCE_M", 0.3)


def _derivative(function, count=6):
    """(N, count) of a function (N,) of a motion (6,), or of more, at rest."""
    columns = [(function(step) - function(-step)) / (2.0 * _STEP) for step in _STEP * np.eye(count)]
    return np.stack(columns, axis=-1)


def _assert_alike(found, expected, tolerance=1e-6):
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance * np.abs(expected).max())


def _pose(target, source, turn_rad, rng, lever_m=4.0):
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(turn_rad * axis / np.linalg.norm(axis)).as_matrix()
    return RigidTransform.from_rotation_translation(target, source, turn, rng.normal(scale=lever_m, size=3))


def _symmetric(rng, scale=1.0, size=6):
    root = rng.normal(size=(size, size)) * np.repeat([scale, 1.0], [3, size - 3])[:, None]
    return root @ root.T


def _pair(target, source, pose, information):
    return PairRegistration(
        target, source, pose, 0.9, 0.05, 1000, converged=True, iterations=5, engine="test", information=information
    )


def _rig(turn_rad, seed=0):
    """Poses in T, turned about any axes, and exact pairs of any information."""
    rng = np.random.default_rng(seed)
    poses = {name: _pose("T", name, turn_rad, rng) for name in "ABC"}
    poses["T"] = RigidTransform.identity("T", "T")
    pairs = [
        _pair(target, source, poses[target].inverse() @ poses[source], _symmetric(rng, 100.0))
        for target, source in combinations("TABC", 2)
    ]
    return poses, pairs


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
@pytest.mark.parametrize("side", [0, 1], ids=["target", "source"])
def test_residuals_of_the_refinement_by_motions_of_either_lidar(turn_rad, side):
    poses, pairs = _rig(turn_rad)
    for pair in pairs[3:]:
        name = (pair.target, pair.source)[side]

        def residual(motion, pair=pair, name=name):
            return refine._offset(pair, {**poses, name: moved(poses[name], motion[:3], motion[3:])})

        _assert_alike(refine._jacobians(pair, poses)[side], _derivative(residual))


_RINGS = {"A": np.array([3, 4, 9]), "B": np.array([5]), "C": np.array([1, 2]), "T": np.array([7, 8])}


def _state(poses, biases=()):
    return refine._State(poses, np.array(biases), ["A", "B", "C"], _RINGS if len(biases) else {})


def _with_biases(pair, rng):
    """The same pair, with any information about pose and biases, and a gradient that this allows.

    It sees the last rings of its LiDARs.
    """
    rings = [_RINGS[name][-2:] for name in (pair.target, pair.source)]
    size = _UNKNOWNS + 3 * sum(map(len, rings))
    root = rng.normal(size=(size, size)) * np.repeat([100.0, 1.0, 30.0], [3, 3, size - 6])[:, None]
    information = root @ root.T
    best, biases = rng.normal(size=size), rng.normal(size=size - 6)
    spread, random = (_symmetric(rng, 100.0, size) for _ in range(2))
    return replace(
        pair, bias_information=BiasInformation(information, -information @ best, spread, random, biases, *rings)
    )


def _off(pairs, rng):
    """The same pairs, off by shifts that their weights show."""
    return [replace(p, T_target_source=moved(p.T_target_source, np.zeros(3), rng.normal(size=3))) for p in pairs]


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
def test_the_gradient_of_the_refinement_is_of_its_robust_cost(turn_rad):
    """Half the squared errors, each through the logarithm of Cauchy; at residuals without a rotation."""
    poses, pairs = _rig(turn_rad)
    rng = np.random.default_rng(1)
    pairs, state, scale = _off(pairs, rng), _state(poses), 6.0 * _CONFIG.outlier_sigma**2

    def cost(step):
        squared = np.array([refine._squared(pair, state.moved(step)) for pair in pairs])
        return np.sum(0.5 * scale * np.log1p(squared / scale), keepdims=True)

    gradient = refine._normal_equations(pairs, state, _CONFIG).gradient
    ways = rng.normal(size=(6, len(gradient)))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    _assert_alike(ways @ gradient, _derivative(lambda step: cost(step @ ways))[0])


def _residual(pair, state):
    """Of the pose, and of the biases of both LiDARs and of their rings."""
    of_lidars = {name: state.biases[4 * index : 4 * index + 4] for index, name in enumerate("ABCT")}
    of_rings, start = {}, 4 * len(_RINGS)
    for name, numbers in _RINGS.items():
        for number in numbers:
            of_rings[name, number] = state.biases[start : start + 3]
            start += 3
    sides = [(pair.target, pair.bias_information.target_rings), (pair.source, pair.bias_information.source_rings)]
    biases = [of_lidars[name] for name, _ in sides] + [of_rings[name, ring] for name, rings in sides for ring in rings]
    return np.concatenate([refine._offset(pair, state.poses), np.concatenate(biases) - pair.bias_information.biases])


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
def test_equations_of_the_refinement_are_of_poses_and_biases(turn_rad):
    """Sums over the pairs of J' g, J' I J and J' S J by their weights, with J by all poses and biases."""
    poses, pairs = _rig(turn_rad)
    rng = np.random.default_rng(7)
    pairs = [_with_biases(pair, rng) for pair in _off(pairs, rng)]
    state = _state(poses, rng.normal(size=4 * BIAS_COUNT + 3 * sum(map(len, _RINGS.values()))))
    size = 18 + len(state.biases)
    gradient, (information, spread, random) = np.zeros(size), np.zeros((3, size, size))
    weights = [1.0 / (1.0 + refine._squared(p, state) / (6.0 * _CONFIG.outlier_sigma**2)) for p in pairs]
    assert min(weights) < 0.85 * max(weights)
    for pair, weight in zip(pairs, weights, strict=True):
        found, jacobian = pair.bias_information, _derivative(lambda step, p=pair: _residual(p, state.moved(step)), size)
        gradient += weight * jacobian.T @ (found.gradient + found.information @ _residual(pair, state))
        information += weight * jacobian.T @ found.information @ jacobian
        spread += weight**2 * jacobian.T @ found.spread @ jacobian
        random += weight**2 * jacobian.T @ found.random_spread @ jacobian
    found = refine._normal_equations(pairs, state, _CONFIG)
    _assert_alike(found.gradient, gradient)
    _assert_alike(found.information, information)
    _assert_alike(found.spread, spread)
    _assert_alike(found.random_spread, random)


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
def test_covariances_are_a_sandwich_of_all_information(turn_rad):
    poses, pairs = _rig(turn_rad)
    free = ["A", "B", "C"]
    normal_matrix, spread = np.zeros((2, 18, 18))
    for pair in pairs:
        columns = []
        for name in free:

            def residual(motion, name=name, pair=pair):
                return refine._offset(pair, {**poses, name: moved(poses[name], motion[:3], motion[3:])})

            columns.append(_derivative(residual))
        jacobian = np.concatenate(columns, axis=1)
        normal_matrix += jacobian.T @ pair.information @ jacobian
        spread += jacobian.T @ pair.information @ jacobian
    random = np.linalg.inv(normal_matrix)
    expected = random @ spread @ random
    found = refine.refine("T", poses, pairs, _CONFIG)
    for index, name in enumerate(free):
        block = slice(6 * index, 6 * index + 6)
        _assert_alike(found.covariances[name], expected[block, block], 1e-5)
        _assert_alike(found.repeatability[name], random[block, block], 1e-5)


def _rooms(turn_rad, seed=0):
    """Target, source and true pose: walls of a room metres away from both sensors, points 0.2 m apart."""
    rng = np.random.default_rng(seed)
    ticks = np.arange(0.0, 5.0, 0.2)
    across, up = (axis.ravel() for axis in np.meshgrid(ticks, ticks))
    flat = np.zeros_like(across)
    sides = (np.column_stack(wall) for wall in ((across, up, flat), (flat + 5.2, across, up), (across, flat - 0.2, up)))
    walls_m = np.concatenate(list(sides)) + np.array([3.0, -2.0, 1.0])
    truth = _pose("t", "s", turn_rad, rng)
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
        return plane_fit._residuals(overlap, moved(pose, step[:3], step[3:6]), rest + step[6:])

    return residuals


_BIASES = np.array([0.015, 2e-3, -1e-3, 2e-3, -0.01, -1e-3, 3e-3, -1e-3])


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
@pytest.mark.parametrize("biases", [None, _BIASES], ids=["unbiased", "biased"])
def test_residuals_of_the_plane_fit_by_motions_of_the_source(turn_rad, biases):
    """They are linear in the biases, but for the turned points of the source."""
    target, source, pose = _rooms(turn_rad)
    overlap = plane_fit._overlap(target, source, pose)
    residuals = _motions(pose, biases)
    here = residuals(overlap, np.zeros(_UNKNOWNS))
    jacobian = _derivative(lambda step: residuals(overlap, step).residual_m, _UNKNOWNS)
    # A scale that both LiDARs have in common moves the source only: it would shrink the noise else.
    jacobian[:, 6 + SCALE] = np.sum(here.normals * here.points_m, axis=1)
    _assert_alike(here.jacobian(overlap, pose), jacobian)

    def cost(motion):
        return 0.5 * np.sum(here.weight * residuals(overlap, motion).residual_m ** 2, keepdims=True)

    _assert_alike(here.gradient, _derivative(cost)[0])


def _clusters(rows):
    members = {}
    for index, row in enumerate(rows):
        members.setdefault(tuple(np.atleast_1d(row)), []).append(index)
    return members.values()


def _summed(rows, clusters):
    return np.array([np.sum(rows[members], axis=0) for members in clusters])


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
def test_information_is_that_of_gradients_by_surface_and_ring(turn_rad):
    """H / v of pose and biases, and B / v^2; v is the median variance with which H would be the information.

    B is over cells of 6 m with the main axis, half by their own sums and half by the usual one, and over rings of both
    LiDARs, 0.15 of each; its random part is over patches of 1 m.
    """
    target, source, pose = _rooms(turn_rad)
    overlap = plane_fit._overlap(target, source, pose)
    here = plane_fit._residuals(overlap, pose, _BIASES)
    dense = here.jacobian(overlap, pose)
    matched_m = (target.points_m[here.index], overlap.points_m[here.rows])
    bands = [np.floor(np.rad2deg(np.arcsin(xyz[:, 2] / np.linalg.norm(xyz, axis=1)))) + 90.0 for xyz in matched_m]
    rings = [np.unique(each) for each in bands]
    of_rings = [
        (part[:, None, :] * (numbers == each[:, None])[:, :, None]).reshape(len(dense), -1)
        for part, each, numbers in zip(here.by_rings(overlap, pose), bands, rings, strict=True)
    ]
    jacobian = np.hstack([dense, *of_rings])
    pulls = here.weight[:, None] * jacobian
    # The surfaces are those at the pose that the fit began with.
    placed_m, normals = pose.apply(overlap.points_m), pose.rotate(overlap.normals)
    surfaces = np.column_stack([np.floor(placed_m / 6.0), np.argmax(np.abs(normals), axis=1)])
    surfaces = _clusters(surfaces[here.rows])

    def squared(clusters, factors=here.residual_m):
        sums = _summed(factors[:, None] * pulls, clusters)
        return sums.T @ sums

    hessian = jacobian.T @ pulls
    noise = plane_fit._MIN_SIGMA_M**2 * hessian
    weights, sums_m = (_summed(each, surfaces) for each in (here.weight, here.weight * here.residual_m))
    alike = squared(surfaces, np.ones(len(pulls)))
    uneven = plane_fit._SURFACE_SIGMA_M**2 * alike
    usual = np.sum(sums_m**2) / np.sum(weights**2) * alike
    of_bands = sum(squared(_clusters(each)) for each in bands)
    spread = 0.5 * (squared(surfaces) + usual) + 0.15 * of_bands + uneven + noise
    remaining = plane_fit._remaining_hessian(overlap, pose, _BIASES, here, hessian)
    assert np.linalg.eigvalsh(hessian[:6, :6] - remaining[:6, :6]).min() > -1e-6 * np.abs(hessian).max()
    remaining, floored = plane_fit._floored(remaining, spread)
    random = squared(_clusters(np.floor(here.points_m))) + noise + floored - spread
    by_surfaces = (squared(surfaces) + uneven + noise)[:6, :6]
    variance = np.median(eigh(by_surfaces, remaining[:6, :6], eigvals_only=True))
    found = plane_fit._with_information(overlap, pose, _BIASES, _BIAS_SIGMAS).biases
    assert all(map(np.array_equal, (found.target_rings, found.source_rings), rings))
    _assert_alike(found.information, remaining / variance, 1e-5)
    _assert_alike(found.spread, floored / variance**2, 1e-5)
    _assert_alike(found.random_spread, random / variance**2, 1e-5)
    sigmas = [ring_sigmas(_BIAS_SIGMAS[:4], len(numbers)) for numbers in rings]
    sigmas = np.concatenate([_BIAS_SIGMAS, *sigmas])
    state = np.concatenate([_BIASES, np.zeros(len(sigmas) - 8)])
    counts = [len(numbers) for numbers in rings]
    known = posterior(remaining / variance, pulls.T @ here.residual_m / variance, state, sigmas, rings=counts)
    _assert_alike(found.biases, state + known.step[6:], 1e-5)
    fitted = plane_fit._with_information(overlap, pose, _BIASES, _BIAS_SIGMAS)
    assert np.allclose(fitted.pose.offset_from(moved(pose, known.step[:3], known.step[3:6])), 0.0, atol=1e-8)
    # At the new pose and biases the gradient is that of the prior.
    known = posterior(
        found.information, found.gradient, found.biases, sigmas, found.spread, found.random_spread, counts
    )
    assert np.abs(known.step[:6]).max() < 1e-7
    _assert_alike(np.linalg.inv(fitted.information), known.covariance, 1e-5)
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
    floored, spread = plane_fit._floored(hessian, others)
    assert np.array_equal(floored[6:], np.eye(9)[6:])
    assert not np.any(spread[6:])
    floored, spread = (each[:6, :6] / np.outer(lengths_m, lengths_m) for each in (floored, spread))
    _assert_alike(floored, (directions * np.maximum(values, 1.0)) @ directions.T, 1e-9)
    _assert_alike(spread, 0.3**2 * directions[:, 1:3] @ directions[:, 1:3].T, 1e-9)


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
def test_a_step_without_biases_is_that_of_newton(turn_rad):
    rng = np.random.default_rng(2)
    hessian, pull = _symmetric(rng, 10.0 * turn_rad), rng.normal(size=6)
    step = posterior(hessian, -pull, np.empty(0), np.empty(0)).step
    _assert_alike(step, np.linalg.solve(hessian, pull))


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
def test_an_offset_is_the_motion_between_two_poses(turn_rad):
    rng = np.random.default_rng(3)
    pose = _pose("t", "s", turn_rad, rng)
    motion = np.concatenate([0.9 * turn_rad * rng.normal(size=3) / 3.0, rng.normal(size=3)])
    np.testing.assert_allclose(moved(pose, motion[:3], motion[3:]).offset_from(pose), motion, rtol=1e-9)


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
def test_a_turn_counts_as_the_arc_at_the_lever(turn_rad):
    rng = np.random.default_rng(4)
    pose = _pose("t", "s", 1.0, rng)
    other = moved(pose, np.array([0.0, turn_rad, 0.0]), np.array([0.0, 0.0, 0.3]))
    assert arc_between_m(pose, other) == pytest.approx(0.3 + 10.0 * turn_rad)
    assert LEVER_ARM_M == 10.0


def test_the_slide_direction_is_the_least_certain_one():
    rng = np.random.default_rng(5)
    for _ in range(20):
        information = _symmetric(rng)
        score = VisibilityScore(9, 0, 0, 0, information, np.zeros(9, dtype=np.uint8))
        variances, directions = np.linalg.eigh(np.linalg.inv(information)[3:, 3:])
        assert variances[-1] > variances[-2]
        assert abs(score.slide_direction @ directions[:, -1]) == pytest.approx(1.0)


@pytest.mark.parametrize("turn_rad", [1e-3, 1e-2])
def test_the_significance_of_a_motion_is_what_it_lifts_points(turn_rad):
    """The engine's Hessian is by motions along the source's axes, T exp(x), rotation first."""
    rng = np.random.default_rng(6)
    points_m, normals = rng.normal(scale=5.0, size=(200, 3)), rng.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    pose = _pose("t", "s", turn_rad, rng, lever_m=0.05)

    def lifted_m(motion):
        by_motion = moved(RigidTransform.identity("s", "s"), motion[:3], motion[3:])
        return np.einsum("ij,ij->i", normals, (pose @ by_motion).apply(points_m) - points_m)

    jacobian = _derivative(lifted_m)
    noise_m = np.sqrt(stillness._NORMAL_VARIANCE_M2)
    result = SimpleNamespace(H=jacobian.T @ jacobian / noise_m**2, num_inliers=len(points_m))
    motion = stillness._motion(result, pose.matrix, StillnessConfig())
    lifted = np.linalg.norm(lifted_m(np.zeros(6))) / noise_m
    assert motion.significance == pytest.approx(lifted, rel=turn_rad)
    assert (motion.turn_rad, motion.shift_m) == pytest.approx((turn_rad, np.linalg.norm(pose.xyz_m)))


def test_what_a_motion_shows_is_along_the_axes_of_the_source():
    cycle = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    pose = RigidTransform.from_rotation_translation("t", "s", cycle, [0.0, 0.3, 0.0])
    walls_across_x = SimpleNamespace(H=np.diag([0.0, 0.0, 0.0, 1e6, 0.0, 0.0]), num_inliers=100)
    motion = stillness._motion(walls_across_x, pose.matrix, StillnessConfig())
    assert (motion.shift_m, motion.turn_rad, motion.significance) == pytest.approx((0.3, 0.0, 300.0))
