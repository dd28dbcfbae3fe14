# SPDX-License-Identifier: Apache-2.0
"""Each derivative against central differences, at large rotations and levers of metres."""

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from multilica.config import RefineConfig, StillnessConfig
from multilica.geometry import LEVER_ARM_M, RigidTransform
from multilica.registration.poses import arc_between_m, moved
from multilica.registration.sensor_biases import BIAS_COUNT, posterior, prior_sigmas
from multilica.registration.view_poses import ViewPoses
from multilica.results import BiasInformation, PairRegistration, ViewPair
from multilica.results.visibility_score import VisibilityScore
from multilica.stages import refine, stillness
from tests.unit.derivatives import TURNS_RAD, assert_alike, derivative, drawn_pose

_CONFIG = RefineConfig()
_BIAS_SIGMAS = np.tile(prior_sigmas("", _CONFIG), 2)
# Unknowns of a pair: its pose, and the biases of both LiDARs.
_UNKNOWNS = 6 + 2 * BIAS_COUNT


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
    poses = {name: drawn_pose("T", name, turn_rad, rng) for name in "ABC"}
    poses["T"] = RigidTransform.identity("T", "T")
    pairs = [
        _pair(target, source, poses[target].inverse() @ poses[source], _symmetric(rng, 100.0))
        for target, source in combinations("TABC", 2)
    ]
    return poses, pairs


@pytest.mark.parametrize("turn_rad", TURNS_RAD)
@pytest.mark.parametrize("side", [0, 1], ids=["target", "source"])
def test_residuals_of_the_refinement_by_motions_of_either_lidar(turn_rad, side):
    poses, pairs = _rig(turn_rad)
    for pair in pairs[3:]:
        name = (pair.target, pair.source)[side]

        def residual(motion, pair=pair, name=name):
            return _offset(pair, {**poses, name: moved(poses[name], motion[:3], motion[3:])})

        jacobian, columns = _views(poses).jacobian(ViewPair(pair, "", ""))
        start = 6 * "ABC".index(name)
        assert_alike(jacobian[:, np.searchsorted(columns, start + np.arange(6))], derivative(residual))


_RINGS = {"A": np.array([3, 4, 9]), "B": np.array([5]), "C": np.array([1, 2]), "T": np.array([7, 8])}


def _state(poses, biases=()):
    return refine._State(_views(poses), np.array(biases), _RINGS if len(biases) else {})


def _views(poses):
    return ViewPoses(poses, {}, ["A", "B", "C"], [])


def _offset(pair, poses):
    return _views(poses).offset(ViewPair(pair, "", ""))


def _equations(pairs, state):
    return refine._normal_equations([ViewPair(pair, "", "") for pair in pairs], state, _CONFIG)


def _squared(pair, state):
    return refine._squared(ViewPair(pair, "", ""), state)


def _with_biases(pair, rng):
    """The same pair, with any information about pose and biases, and a gradient that this allows.

    It sees the last rings of its LiDARs.
    """
    rings = [_RINGS[name][-2:] for name in (pair.target, pair.source)]
    size = _UNKNOWNS + 3 * sum(map(len, rings))
    root = rng.normal(size=(size, size)) * np.repeat([100.0, 1.0, 30.0], [3, 3, size - 6])[:, None]
    information = root @ root.T
    best, biases = rng.normal(size=size), rng.normal(size=size - 6)
    spread, random, few = (_symmetric(rng, 100.0, size) for _ in range(3))
    found = BiasInformation(information, -information @ best, spread, random, biases, *rings, few)
    return replace(pair, bias_information=found)


def _off(pairs, rng):
    """The same pairs, off by shifts that their weights show."""
    return [replace(p, T_target_source=moved(p.T_target_source, np.zeros(3), rng.normal(size=3))) for p in pairs]


@pytest.mark.parametrize("turn_rad", TURNS_RAD)
def test_the_gradient_of_the_refinement_is_of_its_robust_cost(turn_rad):
    """Half the squared errors, each through the logarithm of Cauchy; at residuals without a rotation."""
    poses, pairs = _rig(turn_rad)
    rng = np.random.default_rng(1)
    pairs, state, scale = _off(pairs, rng), _state(poses), 6.0 * _CONFIG.outlier_sigma**2

    def cost(step):
        squared = np.array([_squared(pair, state.moved(step)) for pair in pairs])
        return np.sum(0.5 * scale * np.log1p(squared / scale), keepdims=True)

    _, gradient = _equations(pairs, state)
    ways = rng.normal(size=(6, len(gradient)))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    assert_alike(ways @ gradient, derivative(lambda step: cost(step @ ways))[0])


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
    return np.concatenate([_offset(pair, state.views.poses), np.concatenate(biases) - pair.bias_information.biases])


@pytest.mark.parametrize("turn_rad", TURNS_RAD)
def test_equations_of_the_refinement_are_of_poses_and_biases(turn_rad):
    """Sums over the pairs of J' g, J' I J and J' S J by their weights, with J by all poses and biases.

    Two snapshots have the first pair, so half of what few surfaces add to its spread counts.
    """
    poses, pairs = _rig(turn_rad)
    rng = np.random.default_rng(7)
    pairs = [_with_biases(pair, rng) for pair in _off([pairs[0], *pairs], rng)]
    state = _state(poses, rng.normal(size=4 * BIAS_COUNT + 3 * sum(map(len, _RINGS.values()))))
    size = 18 + len(state.biases)
    gradient, (information, spread, random) = np.zeros(size), np.zeros((3, size, size))
    weights = [1.0 / (1.0 + _squared(p, state) / (6.0 * _CONFIG.outlier_sigma**2)) for p in pairs]
    assert min(weights) < 0.85 * max(weights)
    for number, (pair, weight) in enumerate(zip(pairs, weights, strict=True)):
        found, jacobian = pair.bias_information, derivative(lambda step, p=pair: _residual(p, state.moved(step)), size)
        gradient += weight * jacobian.T @ (found.gradient + found.information @ _residual(pair, state))
        information += weight * jacobian.T @ found.information @ jacobian
        own = found.spread - (0.5 if number < 2 else 0.0) * found.few_spread
        spread += weight**2 * jacobian.T @ own @ jacobian
        random += weight**2 * jacobian.T @ found.random_spread @ jacobian
    found_information, found_gradient = _equations(pairs, state)
    found_spread, found_random = refine._spreads([ViewPair(pair, "", "") for pair in pairs], state, _CONFIG)
    assert_alike(found_gradient, gradient)
    assert_alike(found_information, information)
    assert_alike(found_spread, spread)
    assert_alike(found_random, random)


@pytest.mark.parametrize("turn_rad", TURNS_RAD)
def test_covariances_are_a_sandwich_of_all_information(turn_rad):
    poses, pairs = _rig(turn_rad)
    free = ["A", "B", "C"]
    normal_matrix, spread = np.zeros((2, 18, 18))
    for pair in pairs:
        columns = []
        for name in free:

            def residual(motion, name=name, pair=pair):
                return _offset(pair, {**poses, name: moved(poses[name], motion[:3], motion[3:])})

            columns.append(derivative(residual))
        jacobian = np.concatenate(columns, axis=1)
        normal_matrix += jacobian.T @ pair.information @ jacobian
        spread += jacobian.T @ pair.information @ jacobian
    random = np.linalg.inv(normal_matrix)
    expected = random @ spread @ random
    found = refine.refine("T", poses, pairs, _CONFIG)
    for index, name in enumerate(free):
        block = slice(6 * index, 6 * index + 6)
        assert_alike(found.covariances[name], expected[block, block], 1e-5)
        assert_alike(found.repeatability[name], random[block, block], 1e-5)


@pytest.mark.parametrize("turn_rad", TURNS_RAD)
def test_a_step_without_biases_is_that_of_newton(turn_rad):
    rng = np.random.default_rng(2)
    hessian, pull = _symmetric(rng, 10.0 * turn_rad), rng.normal(size=6)
    step = posterior(hessian, -pull, np.empty(0), np.empty(0)).step
    assert_alike(step, np.linalg.solve(hessian, pull))


@pytest.mark.parametrize("turn_rad", TURNS_RAD)
def test_an_offset_is_the_motion_between_two_poses(turn_rad):
    rng = np.random.default_rng(3)
    pose = drawn_pose("t", "s", turn_rad, rng)
    motion = np.concatenate([0.9 * turn_rad * rng.normal(size=3) / 3.0, rng.normal(size=3)])
    np.testing.assert_allclose(moved(pose, motion[:3], motion[3:]).offset_from(pose), motion, rtol=1e-9)


@pytest.mark.parametrize("turn_rad", TURNS_RAD)
def test_a_turn_counts_as_the_arc_at_the_lever(turn_rad):
    rng = np.random.default_rng(4)
    pose = drawn_pose("t", "s", 1.0, rng)
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
        assert score.slide_share == pytest.approx(variances[-2] / variances[-1])


@pytest.mark.parametrize("turn_rad", [1e-3, 1e-2])
def test_the_significance_of_a_motion_is_what_it_lifts_points(turn_rad):
    """The engine's Hessian is by motions along the source's axes, T exp(x), rotation first."""
    rng = np.random.default_rng(6)
    points_m, normals = rng.normal(scale=5.0, size=(200, 3)), rng.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    pose = drawn_pose("t", "s", turn_rad, rng, lever_m=0.05)

    def lifted_m(motion):
        by_motion = moved(RigidTransform.identity("s", "s"), motion[:3], motion[3:])
        return np.einsum("ij,ij->i", normals, (pose @ by_motion).apply(points_m) - points_m)

    jacobian = derivative(lifted_m)
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
