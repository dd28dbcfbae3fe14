# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.config import FineConfig, RefineConfig
from multilica.geometry import RigidTransform
from multilica.registration import plane_equations, plane_fit, plane_matches, plane_settling
from multilica.registration.gicp import prepare_gicp_cloud
from multilica.registration.plane_fit import fit_planes, pose_information
from multilica.registration.sensor_biases import BIAS_COUNT, posterior, prior_sigmas, ring_sigmas

_SIGMAS = np.tile(prior_sigmas("", RefineConfig()), 2)
_UNBIASED = 1e-3 * _SIGMAS
# Of the sensors in the room.
_PLACE_M = np.array([5.0, 5.2, 1.5])
_HERE = RigidTransform.identity("t", "s")
# All that limit the distance of matches.
_MODULES = plane_equations, plane_fit, plane_matches, plane_settling


@pytest.fixture(autouse=True)
def wide_matching(monkeypatch):
    """Match points up to 0.3 m apart."""
    for module in _MODULES:
        monkeypatch.setattr(module, "DISTANCE_M", 0.3)


def _room(name, seed, roughness_m=(0.01, 0.01, 0.01), count=4000, clutter=0):
    """Three walls of 6 m, points off them by so much across x, y and z, and a bush in the middle."""
    rng = np.random.default_rng(seed)
    walls = []
    for axis, rough_m in enumerate(roughness_m):
        points = rng.uniform(0.0, 6.0, (count, 3))
        points[:, axis] = rng.normal(0.0, rough_m, count)
        walls.append(points)
    return _cloud(name, np.concatenate([*walls, rng.uniform(2.0, 4.0, (clutter, 3))]) - _PLACE_M)


def _cloud(name, points_m):
    return prepare_gicp_cloud(name, points_m, FineConfig())


def _information(target, source, pose=_HERE):
    return pose_information(target, source, pose, _SIGMAS)


def _sigma_m(information):
    return np.sqrt(np.diag(np.linalg.inv(information)))[3:]


def _here(target, source):
    """Where the pose is given: with biases, of which `pose_information` does not tell."""
    overlap = plane_matches.find_overlap(target, source, _HERE)
    found = plane_fit._with_information(overlap, _HERE, np.zeros(2 * BIAS_COUNT), _UNBIASED)
    assert np.array_equal(found.information, pose_information(target, source, _HERE, _UNBIASED).information)
    return found


def _random_covariance(found, bias_sigmas=_UNBIASED):
    """Of the pose of a fit (6, 6): the part that random errors cause."""
    of = found.biases
    rings = (of.target_rings, of.source_rings)
    sigmas = [ring_sigmas(each, len(numbers)) for each, numbers in zip(bias_sigmas.reshape(2, -1), rings, strict=True)]
    sigmas = np.concatenate([bias_sigmas, *sigmas])
    counts = [len(numbers) for numbers in rings]
    return posterior(of.information, of.gradient, of.biases, sigmas, of.spread, of.random_spread, counts).repeatability


def _random_sigma_m(found, bias_sigmas=_UNBIASED):
    return np.sqrt(np.diag(_random_covariance(found, bias_sigmas)))[3:]


def _squared_error(found, truth=_HERE):
    error = found.pose.offset_from(truth)
    return error @ found.information @ error


def _nudged(xyz_m, yaw_rad=0.0):
    return RigidTransform.from_xyz_rpy("t", "s", xyz_m, [0.0, 0.0, yaw_rad])


def test_the_fit_ends_where_the_planes_are_in_common():
    target, source = _room("t", 0), _room("s", 1)
    found = fit_planes(target, source, _nudged([0.04, -0.03, 0.05], 0.01), _UNBIASED)
    metres, radians = found.pose.distance_to(_HERE)
    assert metres < 0.002
    assert radians < np.deg2rad(0.02)
    again = pose_information(target, source, found.pose, _UNBIASED)
    # The surfaces of the points are those at the pose that is given.
    assert np.allclose(_sigma_m(found.information), _sigma_m(again.information), rtol=0.05)
    assert np.all(_random_sigma_m(found) <= _sigma_m(found.information))


def test_biases_that_may_be_cost_certainty_only():
    target, source = _room("t", 0), _room("s", 1)
    found, unbiased = (fit_planes(target, source, _nudged([0.04, -0.03, 0.05]), each) for each in (_SIGMAS, _UNBIASED))
    assert found.pose.distance_to(_HERE)[0] < 0.005
    assert _squared_error(found) < 12.0
    assert np.all(_sigma_m(found.information) > 1.1 * _sigma_m(unbiased.information))
    assert np.all(_random_sigma_m(found, _SIGMAS) < _sigma_m(found.information))


@pytest.mark.in_turn
def test_bushes_do_not_pull_the_fit():
    """One side has shifted foliage that fits better elsewhere; planes outweigh it."""
    target, source = _room("t", 0, clutter=6000), _room("s", 1)
    bush_m = target.points_m[np.all(target.points_m + _PLACE_M > 1.9, axis=1)] + [0.06, 0.06, 0.06]
    source = _cloud("s", np.concatenate([source.points_m, bush_m]))
    found, unbiased = (fit_planes(target, source, _nudged([0.02, 0.0, 0.0]), each) for each in (_SIGMAS, _UNBIASED))
    assert unbiased.pose.distance_to(_HERE)[0] < 0.002
    assert found.pose.distance_to(_HERE)[0] < 0.018
    assert _squared_error(found) < 20.0


def test_few_points_in_common_leave_the_pose():
    target, source = _room("t", 0), _room("s", 1)
    away = _nudged([100.0, 0.0, 0.0])
    for found in (fit_planes(target, source, away, _SIGMAS), pose_information(target, source, away, _SIGMAS)):
        assert found.pose is away
        assert (found.information, found.biases) == (None, None)


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_fit_that_leads_away_is_not_taken(monkeypatch):
    target, source = _room("t", 0), _room("s", 1)
    off = _nudged([0.16, 0.16, 0.16])
    assert fit_planes(target, source, off, _SIGMAS).pose.distance_to(_HERE)[0] < 0.01
    for module in _MODULES:
        monkeypatch.setattr(module, "DISTANCE_M", 0.2)
    given = fit_planes(target, source, off, _SIGMAS)
    assert given.pose is off
    assert given.biases is None
    assert np.array_equal(given.information, _information(target, source, off).information)


def test_more_points_than_wanted_are_thinned_evenly(monkeypatch):
    target, source = _room("t", 0), _room("s", 1)
    of_all = fit_planes(target, source, _HERE, _UNBIASED)
    monkeypatch.setattr(plane_settling, "MAX_POINTS", 800)
    of_fewer = fit_planes(target, source, _HERE, _UNBIASED)
    assert of_fewer.pose.distance_to(_HERE)[0] < 0.004
    assert np.trace(_random_covariance(of_fewer)) > 1.7 * np.trace(_random_covariance(of_all))


@pytest.mark.in_turn
def test_rough_surfaces_constrain_a_direction_less():
    smooth, rough = (
        _random_sigma_m(fit_planes(_room("t", 0, roughness), _room("s", 1, roughness), _HERE, _UNBIASED))
        for roughness in ((0.01, 0.01, 0.01), (0.08, 0.01, 0.01))
    )
    assert rough[0] > 2.0 * smooth[0]
    assert rough[0] > 1.5 * rough[1:].max()


def test_correlated_residuals_widen_the_covariance():
    """The same spread of residuals, by point or by square metre of wall."""
    alike, together = _room("t", 0, (0.001,) * 3), _room("s", 1, (0.001,) * 3)
    rng = np.random.default_rng(2)
    by_point = rng.normal(0.0, 0.01, together.points_m.shape)
    patches = np.floor(together.points_m).astype(int)
    by_patch = rng.normal(0.0, 0.01, (8, 8, 8, 3))[tuple(np.clip(patches, -1, 6).T)]
    scattered, uneven = (
        _random_sigma_m(fit_planes(alike, _cloud("s", together.points_m + off), _HERE, _UNBIASED))
        for off in (by_point, by_patch)
    )
    assert np.all(uneven > 1.25 * scattered)


@pytest.mark.parametrize("noise_m", [0.0, 1e-6, 1e-3, 3e-3])
def test_an_unconstrained_direction_has_no_information(noise_m):
    rng = np.random.default_rng(0)
    target, source = (
        _cloud(name, np.column_stack([rng.uniform(-5.0, 5.0, (4000, 2)), rng.normal(-2.0, noise_m, 4000)]))
        for name in "ts"
    )
    found = _here(target, source)
    for sigma_m in (_sigma_m(found.information), _random_sigma_m(found)):
        assert np.all(sigma_m[:2] > 0.05)
        # Four surfaces are few.
        assert sigma_m[2] < 0.003


def test_normals_that_are_mostly_noise_constrain_nothing():
    """Rings of a sparse sensor on flat ground: each ring alone tells the slope across it from noise only."""
    rng = np.random.default_rng(0)
    azimuth = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    across = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1)

    def rings(name, first_m):
        radii_m = first_m * 1.25 ** np.arange(10.0)
        ground = np.concatenate([np.column_stack([radius_m * across, np.full(720, -2.0)]) for radius_m in radii_m])
        return _cloud(name, ground + rng.normal(0.0, 0.02, ground.shape))

    target, source = rings("t", 3.0), rings("s", 3.1)
    found = _here(target, source)
    for sigma_m in (_sigma_m(found.information), _random_sigma_m(found)):
        assert np.all(sigma_m[:2] > 0.03)
        assert sigma_m[2] < 0.01


@pytest.mark.in_turn
@pytest.mark.slow
def test_the_truth_lies_as_far_off_as_the_covariance_says():
    """Over many rooms the squared normalised error is about the six degrees of freedom."""
    squared = []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        turn = Rotation.from_rotvec(rng.normal(0.0, 0.3, 3)).as_matrix()
        truth = RigidTransform.from_rotation_translation("t", "s", turn, rng.normal(0.0, 0.5, 3))
        target, other = (_room(name, (seed, index), (0.015,) * 3, 1500) for index, name in enumerate("ts"))
        source = _cloud("s", truth.inverse().apply(other.points_m))
        squared.append(_squared_error(fit_planes(target, source, truth, _SIGMAS), truth))
    assert 2.0 < np.mean(squared) < 9.0
    assert np.max(squared) < 22.0


def _drawn_equations(rng, unknowns=14):
    """Information, gradient and spread of a pose and biases, with more spread than information along some axes."""
    scale = np.concatenate([np.full(3, 10.0), np.ones(unknowns - 3)])
    jacobian, other = rng.normal(size=(2, 40, unknowns)) * scale
    information = jacobian.T @ jacobian
    more = other * rng.uniform(0.0, 3.0, size=unknowns)
    return information, rng.normal(size=unknowns), information + more.T @ more


def test_weights_by_direction_leave_the_solution_of_one_pair():
    information, gradient, spread = _drawn_equations(np.random.default_rng(5))
    changed, pulled, wide, random = plane_fit._weighted(information, gradient, spread, 0.5 * spread)
    pose = np.linalg.solve(changed[:6, :6], changed[:6, 6:])
    assert np.allclose(pose, np.linalg.solve(information[:6, :6], information[:6, 6:]))
    assert np.allclose(np.linalg.solve(changed, pulled), np.linalg.solve(information, gradient))
    sandwich = np.linalg.inv(information) @ spread @ np.linalg.inv(information)
    assert np.allclose(np.linalg.inv(changed) @ wide @ np.linalg.inv(changed), sandwich)
    assert np.allclose(random, 0.5 * wide)


def test_weights_by_direction_are_the_best_for_two_pairs():
    """The best linear combination of two poses has the sum of the inverse covariances as information."""
    rng = np.random.default_rng(6)
    pairs, plain = [], []
    for _ in range(2):
        information, gradient, spread = (part[..., :6] for part in _drawn_equations(rng))
        information, spread = information[:6], spread[:6]
        pairs.append(plane_fit._weighted(information, gradient, spread, spread))
        plain.append((information, gradient, spread))
    best = np.linalg.inv(sum(info @ np.linalg.inv(spread) @ info for info, _, spread in plain))

    def covariance(equations):
        bread = np.linalg.inv(sum(each[0] for each in equations))
        return bread @ sum(each[2] for each in equations) @ bread

    assert np.trace(covariance(plain)) > 1.1 * np.trace(best)
    assert np.allclose(covariance(pairs), best)


def test_directions_with_little_spread_gain_no_weight():
    information, gradient, _ = _drawn_equations(np.random.default_rng(7))
    same = plane_fit._weighted(information, gradient, 0.01 * information, 0.01 * information)
    assert np.allclose(same[0], information)
    assert np.allclose(same[1], gradient)
