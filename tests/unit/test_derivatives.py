# SPDX-License-Identifier: Apache-2.0
"""Each derivative against central differences, at large rotations and levers of metres."""

from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.spatial.transform import Rotation

from multilica.config import FineConfig, RefineConfig, StillnessConfig
from multilica.geometry import LEVER_ARM_M, RigidTransform
from multilica.registration import plane_fit
from multilica.registration.gicp import prepare_gicp_cloud
from multilica.registration.poses import arc_between_m, moved
from multilica.results import PairRegistration
from multilica.results.visibility_score import VisibilityScore
from multilica.stages import refine, stillness

_STEP = 1e-5
_TURNS_RAD = (0.1, 1.0, 2.0, 3.0)
_CONFIG = RefineConfig()


@pytest.fixture(autouse=True)
def wide_matching(monkeypatch):
    """Match points up to 0.3 m apart."""
    monkeypatch.setattr(plane_fit, "_DISTANCE_M", 0.3)


def _derivative(function):
    """(N, 6) of a function (N,) of a motion (6,), at rest."""
    columns = [(function(step) - function(-step)) / (2.0 * _STEP) for step in _STEP * np.eye(6)]
    return np.stack(columns, axis=-1)


def _assert_alike(found, expected, tolerance=1e-6):
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance * np.abs(expected).max())


def _pose(target, source, turn_rad, rng, lever_m=4.0):
    axis = rng.normal(size=3)
    turn = Rotation.from_rotvec(turn_rad * axis / np.linalg.norm(axis)).as_matrix()
    return RigidTransform.from_rotation_translation(target, source, turn, rng.normal(scale=lever_m, size=3))


def _symmetric(rng, scale=1.0):
    root = rng.normal(size=(6, 6)) * np.repeat([scale, 1.0], 3)[:, None]
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
            return refine._residual(pair, {**poses, name: moved(poses[name], motion[:3], motion[3:])})

        _assert_alike(refine._jacobians(pair, poses)[side], _derivative(residual))


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
def test_the_gradient_of_the_refinement_is_of_its_robust_cost(turn_rad):
    """Half the squared errors, each through the logarithm of Cauchy; at residuals without a rotation."""
    poses, pairs = _rig(turn_rad)
    rng = np.random.default_rng(1)
    shifted = [
        _pair(p.target, p.source, moved(p.T_target_source, np.zeros(3), rng.normal(size=3)), p.information)
        for p in pairs
    ]
    free, scale = ["A", "B", "C"], 6.0 * _CONFIG.outlier_sigma**2

    def cost(step):
        after = refine._move(poses, free, step)
        residuals = ((refine._residual(pair, after), pair.information) for pair in shifted)
        return sum(0.5 * scale * np.log1p(residual @ weight @ residual / scale) for residual, weight in residuals)

    _, gradient = refine._normal_equations(shifted, poses, free, _CONFIG)
    forth, back = (approx_fprime(np.zeros(18), lambda x, sign=sign: cost(sign * x), 1e-6) for sign in (1.0, -1.0))
    _assert_alike(gradient, 0.5 * (forth - back))


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
def test_covariances_are_the_inverse_of_all_information(turn_rad):
    poses, pairs = _rig(turn_rad)
    free = ["A", "B", "C"]
    normal_matrix = np.zeros((18, 18))
    for pair in pairs:
        columns = []
        for name in free:

            def residual(motion, name=name, pair=pair):
                return refine._residual(pair, {**poses, name: moved(poses[name], motion[:3], motion[3:])})

            columns.append(_derivative(residual))
        jacobian = np.concatenate(columns, axis=1)
        normal_matrix += jacobian.T @ pair.information @ jacobian
    expected = np.linalg.inv(normal_matrix)
    # Each in a snapshot of its own, so that no noise is shared.
    found = refine.refine("T", poses, pairs, _CONFIG, [str(index) for index in range(len(pairs))]).covariances
    for index, name in enumerate(free):
        block = slice(6 * index, 6 * index + 6)
        _assert_alike(found[name], expected[block, block], 1e-5)


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


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
def test_residuals_of_the_plane_fit_by_motions_of_the_source(turn_rad):
    target, source, pose = _rooms(turn_rad)
    overlap = plane_fit._overlap(target, source, pose)
    here = plane_fit._residuals(overlap, pose)

    def residual_m(motion):
        return plane_fit._residuals(overlap, moved(pose, motion[:3], motion[3:])).residual_m

    jacobian = _derivative(residual_m)
    _assert_alike(here.jacobian, jacobian)
    _assert_alike(here.hessian, jacobian.T @ (here.weight[:, None] * jacobian))

    def cost(motion):
        return 0.5 * np.sum(here.weight * residual_m(motion) ** 2, keepdims=True)

    _assert_alike(here.gradient, _derivative(cost)[0])


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
def test_information_of_a_pose_is_that_of_its_gradients_by_patch(turn_rad):
    """H B^-1 H, with B the sum over patches of 1 m of the outer products of the gradients, and the least noise."""
    target, source, pose = _rooms(turn_rad)
    overlap = plane_fit._overlap(target, source, pose)
    here = plane_fit._residuals(overlap, pose)
    jacobian = _derivative(lambda motion: plane_fit._residuals(overlap, moved(pose, motion[:3], motion[3:])).residual_m)
    patches = {}
    for index, point_m in enumerate(np.floor(here.points_m)):
        patches.setdefault(tuple(point_m), []).append(index)
    pulls = here.weight[:, None] * jacobian
    spread = (plane_fit._MIN_SIGMA_M * pulls).T @ (plane_fit._MIN_SIGMA_M * pulls)
    for members in patches.values():
        gradient = np.sum(here.residual_m[members, None] * pulls[members], axis=0)
        spread += np.outer(gradient, gradient)
    remaining = plane_fit._remaining_hessian(overlap, pose, here)
    found = plane_fit.pose_information(target, source, pose)
    _assert_alike(found, remaining @ np.linalg.inv(spread) @ remaining, 1e-5)
    assert np.linalg.eigvalsh(here.hessian - remaining).min() > -1e-6 * np.abs(here.hessian).max()


@pytest.mark.parametrize("turn_rad", _TURNS_RAD)
def test_a_step_of_the_plane_fit_is_that_of_newton(turn_rad):
    rng = np.random.default_rng(2)
    hessian, pull = _symmetric(rng, 10.0 * turn_rad), rng.normal(size=6)
    _assert_alike(plane_fit._solved(hessian, pull), np.linalg.solve(hessian, pull))


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
