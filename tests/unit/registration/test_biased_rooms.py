# SPDX-License-Identifier: Apache-2.0
"""Plane fit of two LiDARs whose ranges and angles are off, as those of real ones are."""

import numpy as np
import pytest

from multilica.config import FineConfig, RefineConfig
from multilica.geometry import RigidTransform
from multilica.registration.gicp import prepare_gicp_cloud
from multilica.registration.plane_fit import fit_planes
from multilica.registration.sensor_biases import BIAS_COUNT, SCALE, posterior, prior_sigmas, ring_sigmas
from tests.unit.made_rooms import Face, box, scan

_SIGMAS = np.tile(prior_sigmas("", RefineConfig()), 2)
_TARGET = RigidTransform.from_xyz_rpy("world", "t", [-1.0, 0.0, 1.8], [0.02, 0.03, 0.4])
_SOURCE = RigidTransform.from_xyz_rpy("world", "s", [1.0, 1.5, 1.2], [-0.02, 0.04, -1.2])
_TRUTH = _TARGET.inverse() @ _SOURCE
_RINGS = 32
# Open at one end and above: nothing there holds a pose that biased ranges push away.
_YARD = [
    Face(0, 10.0, (10.0, -6.0, 0.0), (10.0, 7.0, 8.0)),
    Face(1, -6.0, (-9.0, -6.0, 0.0), (10.0, -6.0, 8.0)),
    Face(1, 7.0, (-9.0, 7.0, 0.0), (10.0, 7.0, 8.0)),
    Face(2, 0.0, (-9.0, -6.0, 0.0), (10.0, 7.0, 0.0)),
    *box((4.0, 3.0, 0.0), (5.0, 4.0, 4.0)),
    *box((-5.0, -4.0, 0.0), (-4.0, -3.0, 2.0)),
]


def _cloud(name, pose, seed, **biases):
    cloud = scan(name, pose, _YARD, seed=seed, rings=_RINGS, columns=240, **biases)
    return prepare_gicp_cloud(name, cloud.points_m, FineConfig())


def _clouds(seed, of_target, of_source):
    return _cloud("t", _TARGET, (seed, 0), **of_target), _cloud("s", _SOURCE, (seed, 1), **of_source)


def _squared_error(found):
    error = found.pose.offset_from(_TRUTH)
    return error @ found.information @ error


@pytest.fixture(scope="module")
def biased():
    return _clouds(0, {"range_bias_m": 0.015}, {"range_bias_m": -0.010})


def test_ranges_that_are_off_do_not_push_the_pose(biased):
    found, plain = (fit_planes(*biased, _TRUTH, sigmas) for sigmas in (_SIGMAS, 1e-4 * _SIGMAS))
    assert plain.pose.distance_to(_TRUTH)[0] > 0.02
    assert np.allclose(plain.biases.biases, 0.0, atol=1e-5)
    assert found.pose.distance_to(_TRUTH)[0] < 0.002
    assert found.pose.distance_to(_TRUTH)[1] < np.deg2rad(0.02)
    assert _squared_error(found) < 16.8
    assert np.allclose(found.biases.biases[[0, BIAS_COUNT]], [0.015, -0.010], atol=0.004)


def test_a_lidar_with_its_own_datasheet_takes_the_bias(biased):
    """Only the target's ranges may be off: the source's error goes elsewhere."""
    sigmas = _SIGMAS.copy()
    sigmas[BIAS_COUNT] = 1e-6
    found = fit_planes(*biased, _TRUTH, sigmas)
    assert found.biases.biases[0] > 0.01
    assert abs(found.biases.biases[BIAS_COUNT]) < 1e-5


@pytest.mark.slow
def test_angles_that_are_off_do_not_tilt_the_pose():
    off_rad = np.deg2rad(0.1)
    biased = _clouds(1, {"elevation_bias_rad": off_rad}, {"elevation_bias_rad": -off_rad})
    wide = _SIGMAS.copy()
    wide[[1, 1 + BIAS_COUNT]] = off_rad
    found, plain = (fit_planes(*biased, _TRUTH, sigmas) for sigmas in (wide, 1e-4 * _SIGMAS))
    assert _squared_error(found) < 16.8
    assert abs(plain.pose.xyz_m[2] - _TRUTH.xyz_m[2]) > 3.0 * abs(found.pose.xyz_m[2] - _TRUTH.xyz_m[2])
    assert np.allclose(found.biases.biases[[1, 1 + BIAS_COUNT]], [off_rad, -off_rad], atol=0.3 * off_rad)


def test_scales_that_are_off_do_not_push_the_pose():
    """A scale that both have in common only looks like another distance of the LiDARs, so the difference is found."""
    scale = 2e-3
    biased = _clouds(2, {"range_scale": scale}, {"range_scale": -scale})
    wide = _SIGMAS.copy()
    # A yard is small: ranges that may be off explain a scale as well.
    wide[[0, BIAS_COUNT]], wide[[SCALE, SCALE + BIAS_COUNT]] = 1e-5, scale
    found, plain = (fit_planes(*biased, _TRUTH, sigmas) for sigmas in (wide, 1e-4 * _SIGMAS))
    assert plain.pose.distance_to(_TRUTH)[0] > 0.02
    assert found.pose.distance_to(_TRUTH)[0] < 0.005
    assert _squared_error(found) < 16.8
    of_target, of_source = found.biases.biases[[SCALE, SCALE + BIAS_COUNT]]
    assert of_target - of_source == pytest.approx(2.0 * scale, rel=0.1)
    assert min(of_target, -of_source) > 0.0


def test_the_scale_of_one_lidar_is_found():
    """The other's is known."""
    scale = 2e-3
    sigmas = _SIGMAS.copy()
    sigmas[[0, BIAS_COUNT]], sigmas[[SCALE, SCALE + BIAS_COUNT]] = 1e-5, (scale, 1e-7)
    found = fit_planes(*_clouds(3, {"range_scale": scale}, {}), _TRUTH, sigmas)
    assert found.biases.biases[SCALE] == pytest.approx(scale, rel=0.2)
    assert abs(found.biases.biases[SCALE + BIAS_COUNT]) < 1e-6
    assert found.pose.distance_to(_TRUTH)[0] < 0.003
    assert _squared_error(found) < 16.8


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scale", "least", "of_random_errors"), [(0.0, 0.4, (3.0, 9.0)), (1.0, 1.5, (12.0, 60.0))], ids=["ideal", "real"]
)
@pytest.mark.in_turn
def test_the_truth_lies_as_far_off_as_the_covariance_says(scale, least, of_random_errors):
    """Each LiDAR and each ring is off, in range and elevation. Random errors alone explain an ideal LiDAR only."""
    squared, random = [], []
    for seed in range(24):
        rng = np.random.default_rng(seed)
        biases = [
            {
                "range_bias_m": scale * (0.010 * rng.normal() + 0.008 * rng.normal(size=_RINGS)),
                "elevation_bias_rad": scale * np.deg2rad(0.03) * rng.normal(size=_RINGS),
            }
            for _ in range(2)
        ]
        found = fit_planes(*_clouds(seed, *biases), _TRUTH, _SIGMAS)
        error = found.pose.offset_from(_TRUTH)
        squared.append(_squared_error(found))
        of = found.biases
        counts = [len(of.target_rings), len(of.source_rings)]
        rings = [ring_sigmas(_SIGMAS[:BIAS_COUNT], len(numbers)) for numbers in (of.target_rings, of.source_rings)]
        sigmas = np.concatenate([_SIGMAS, *rings])
        known = posterior(of.information, of.gradient, of.biases, sigmas, of.spread, of.random_spread, counts)
        random.append(error @ np.linalg.solve(known.repeatability, error))
    assert least < np.mean(squared) < 9.0
    assert np.max(squared) < 22.5
    assert of_random_errors[0] < np.mean(random) < of_random_errors[1]
