# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from multilica.config import AcceptanceConfig, FineConfig, RefineConfig
from multilica.geometry import LEVER_ARM_M, RigidTransform
from multilica.registration.gicp import prepare_gicp_cloud, register
from multilica.registration.plane_fit import pose_information
from multilica.registration.sensor_biases import BIAS_COUNT, prior_sigmas
from multilica.registration.stability import check_stability, perturbed_ends
from multilica.registration.widening import loosened, widened, widened_with_biases
from multilica.results import BiasInformation
from multilica.results.registrations import weakest_sigmas
from tests.unit.made_pairs import pair
from tests.unit.made_rooms import HALL, box, scan

_CONFIG, _FINE = AcceptanceConfig(), FineConfig()
_BIAS_SIGMAS = np.tile(prior_sigmas("", RefineConfig()), 2)
_TARGET = RigidTransform.from_xyz_rpy("world", "t", [-1.0, 0.0, 1.8], [0.03, 0.1, 0.4])
_SOURCE = RigidTransform.from_xyz_rpy("world", "s", [1.0, 0.8, 1.6], [-0.1, 0.2, -1.2])
_TRUTH = _TARGET.inverse() @ _SOURCE
_ALONG = np.concatenate([np.zeros(3), _TARGET.rotation.T @ [1.0, 0.0, 0.0]])
_CORRIDOR = box((-80.0, -2.0, 0.0), (80.0, 2.0, 3.0))


def _registered(objects):
    clouds = scan("t", _TARGET, objects), scan("s", _SOURCE, objects, seed=1)
    ready = tuple(prepare_gicp_cloud(cloud.lidar, cloud.points_m, _FINE) for cloud in clouds)
    fewer = _FINE.model_copy(update={"max_points": 2000})
    thinned = tuple(prepare_gicp_cloud(cloud.name, cloud.points_m, fewer) for cloud in ready)
    registration = register(*ready, _TRUTH, _FINE)
    information = pose_information(*ready, registration.T_target_source, _BIAS_SIGMAS).information
    return ready, thinned, replace(registration, information=information)


def _stability(clouds, thinned, registration):
    ends = perturbed_ends(clouds, registration.T_target_source, _ALONG, _CONFIG.perturbation_m, _FINE)
    pose, information = registration.T_target_source, registration.information
    return check_stability(thinned, pose, information, ends, _CONFIG.perturbation_m, _FINE)


@pytest.fixture(scope="module")
def in_the_hall():
    return _registered(HALL)


def test_a_constrained_pose_returns(in_the_hall):
    stability = _stability(*in_the_hall)
    assert stability.perturbation_m == _CONFIG.perturbation_m
    assert stability.perturbed_offset_m < 1e-3
    assert stability.thinned_offset_m < 0.03
    assert stability.sigma_m < 0.005
    assert stability.sigma_rad < np.deg2rad(0.05)


@pytest.mark.slow
def test_along_a_corridor_a_pose_stays_where_it_is_pushed():
    stability = _stability(*_registered(_CORRIDOR))
    assert stability.perturbed_offset_m > _CONFIG.max_perturbed_offset_m


def test_sigmas_are_those_of_the_weakest_directions(in_the_hall):
    clouds, thinned, registration = in_the_hall
    variances = np.array([4e-8, 1e-8, 2e-8, 1e-6, 9e-6, 4e-6])
    known = replace(registration, information=np.diag(1.0 / variances))
    stability = _stability(clouds, thinned, known)
    assert (stability.sigma_rad, stability.sigma_m) == pytest.approx((2e-4, 3e-3))
    unknown = _stability(clouds, thinned, replace(registration, information=None))
    assert (unknown.sigma_rad, unknown.sigma_m) == (None, None)


_SIGMAS = np.array([1e-4, 2e-4, 3e-4, 2e-3, 3e-3, 4e-3])


def _direction(index):
    return np.eye(6)[index]


def test_the_covariance_grows_by_what_a_push_moved():
    turned = np.linalg.qr(np.random.default_rng(0).normal(size=(6, 6)))[0] * _SIGMAS[:, None]
    before = turned @ turned.T
    direction = np.array([0.3, 0.0, -0.2, 0.8, 0.4, 0.1])
    after = np.linalg.inv(widened(np.linalg.inv(before), direction, 0.05))
    step = 0.05 * direction / np.repeat([LEVER_ARM_M, 1.0], 3)
    assert np.allclose(after, before + np.outer(step, step), rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize(("index", "expected"), [(3, (3e-4, 0.05)), (0, (0.005, 4e-3))], ids=["shift", "turn"])
def test_a_pose_that_a_push_moves_is_less_certain(index, expected):
    information = np.diag(1.0 / _SIGMAS**2)
    sigma_m, sigma_rad = weakest_sigmas(widened(information, _direction(index), 0.05))
    assert (sigma_rad, sigma_m) == pytest.approx(expected, rel=0.01)


def test_a_pose_that_returns_keeps_its_covariance():
    information = np.diag(1.0 / _SIGMAS**2)
    assert np.array_equal(widened(information, _direction(4), 0.0), information)


def test_a_push_leaves_what_is_known_of_biases():
    root = np.random.default_rng(1).normal(size=(12, 12))
    before = np.linalg.inv(root @ root.T)
    after = np.linalg.inv(widened(root @ root.T, _direction(4), 0.05))
    assert np.allclose(after[6:], before[6:], rtol=1e-6)
    assert np.isclose(after[4, 4], before[4, 4] + 0.05**2)


def test_an_offset_is_added_to_the_covariance_of_pose_and_biases():
    """Not to what random errors cause of it."""
    rng = np.random.default_rng(0)
    size = 6 + 2 * BIAS_COUNT
    roots = rng.normal(size=(3, size, size))
    information, spread, random = roots @ roots.transpose(0, 2, 1) + np.eye(size)
    found = BiasInformation(information, np.zeros(size), spread, random, np.zeros(2 * BIAS_COUNT))
    direction, off_m = rng.normal(size=6), 0.3
    wide = widened_with_biases(found, direction, off_m)
    step = np.concatenate([off_m * direction / np.repeat([10.0, 1.0], 3), np.zeros(2 * BIAS_COUNT)])
    before, after = np.linalg.inv(information), np.linalg.inv(wide.information)
    np.testing.assert_allclose(after, before + np.outer(step, step), atol=1e-9)
    expected = before @ spread @ before + np.outer(step, step)
    np.testing.assert_allclose(after @ wide.spread @ after, expected, atol=1e-9 * np.abs(expected).max())
    expected = before @ random @ before
    np.testing.assert_allclose(after @ wide.random_spread @ after, expected, atol=1e-9 * np.abs(expected).max())


def test_a_loosened_registration_has_larger_sigmas():
    rng = np.random.default_rng(2)
    found, spread = (root @ root.T for root in rng.normal(size=(2, 14, 14)))
    biases = BiasInformation(found, rng.normal(size=14), spread, 0.5 * spread, np.zeros(8))
    before = replace(pair(_TRUTH), information=np.linalg.inv(found)[:6, :6], bias_information=biases)
    after = loosened(before, 3.0)
    assert np.allclose(9.0 * after.information, before.information)
    bread = [np.linalg.inv(each.bias_information.information) for each in (before, after)]
    sandwiches = [one @ each.bias_information.spread @ one for one, each in zip(bread, (before, after), strict=True)]
    assert np.allclose(sandwiches[1], 9.0 * sandwiches[0])
    steps = [one @ each.bias_information.gradient for one, each in zip(bread, (before, after), strict=True)]
    assert np.allclose(*steps)
    assert loosened(replace(before, information=None), 3.0).information is None
