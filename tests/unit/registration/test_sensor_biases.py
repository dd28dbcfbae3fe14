# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.config import RefineConfig
from multilica.geometry import Z_AXIS
from multilica.registration import sensor_biases
from multilica.registration.sensor_biases import (
    BIAS_COUNT,
    distrust,
    distrust_of_chains,
    posterior,
    prior_sigmas,
    ring_numbers,
    shifts_per_bias,
    shifts_per_ring_bias,
    slopes_per_bias,
)

_SIGMAS = np.array([0.02, 3e-4, 2e-4, 3e-4])


def _points(spherical):
    """Points (N, 3) of range, elevation and azimuth, and of a scale of the range."""
    range_m, elevation, azimuth, scale = spherical.T
    range_m = range_m * scale
    flat_m = range_m * np.cos(elevation)
    return np.column_stack([flat_m * np.cos(azimuth), flat_m * np.sin(azimuth), range_m * np.sin(elevation)])


def test_shifts_are_the_derivatives_of_spherical_coordinates():
    rng = np.random.default_rng(0)
    angles = rng.uniform(-1.4, 1.4, 500), rng.uniform(-3.1, 3.1, 500)
    spherical = np.column_stack([rng.uniform(1, 80, 500), *angles, np.ones(500)])
    of_range, elevation, azimuth, scale = (
        (_points(spherical + step) - _points(spherical - step)) / 2e-6 for step in 1e-6 * np.eye(4)
    )
    found = shifts_per_bias(_points(spherical), rng.normal(size=(500, 3)), Z_AXIS)
    assert found.shape == (BIAS_COUNT, 500, 3)
    np.testing.assert_allclose(found[:3], [of_range, elevation, scale], rtol=0, atol=1e-6)
    found = shifts_per_ring_bias(_points(spherical), Z_AXIS)
    np.testing.assert_allclose(found, [of_range, elevation, azimuth], rtol=0, atol=1e-6)


def test_a_grazed_surface_shifts_points_along_their_beams():
    points_m, angle_rad = np.array([[4.0, 0.0, 0.0]] * 3), np.deg2rad([0.0, 60.0, 90.0])
    normals = -np.column_stack([np.cos(angle_rad), np.sin(angle_rad), np.zeros(3)])
    expected = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [1.0, 0.0, 0.0]]
    np.testing.assert_allclose(shifts_per_bias(points_m, normals, Z_AXIS)[3], expected, atol=1e-12)


def test_slopes_are_the_shifts_along_the_normals():
    rng = np.random.default_rng(1)
    points_m, normals = rng.normal(scale=20.0, size=(200, 3)), rng.normal(size=(200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    expected = np.einsum("ij,kij->ik", normals, shifts_per_bias(points_m, normals, Z_AXIS))
    np.testing.assert_allclose(slopes_per_bias(points_m, normals, Z_AXIS), expected, atol=1e-9)


@pytest.mark.parametrize("turn", [np.eye(3)[[1, 2, 0]], *Rotation.random(2, random_state=3).as_matrix()])
def test_elevations_may_count_from_any_axis(turn):
    """As if the frame was turned so that the axis becomes z."""
    rng = np.random.default_rng(2)
    points_m, normals = rng.normal(scale=20.0, size=(50, 3)), rng.normal(size=(50, 3))
    turned, turned_normals = points_m @ turn.T, normals @ turn.T
    axis = turn[2]
    for found, expected in (
        (shifts_per_bias(points_m, normals, axis), shifts_per_bias(turned, turned_normals, Z_AXIS)),
        (shifts_per_ring_bias(points_m, axis), shifts_per_ring_bias(turned, Z_AXIS)),
    ):
        np.testing.assert_allclose(found @ turn.T, expected, atol=1e-9)
    np.testing.assert_allclose(
        slopes_per_bias(points_m, normals, axis), slopes_per_bias(turned, turned_normals, Z_AXIS), atol=1e-9
    )
    assert np.array_equal(ring_numbers(points_m, axis), ring_numbers(turned, Z_AXIS))


def test_shifts_of_points_on_the_axis_are_finite():
    points_m = np.array([[0.0, 0.0, 3.0], [0.0, 0.0, -3.0], [0.0, 0.0, 0.0]])
    assert np.all(np.isfinite(shifts_per_bias(points_m, np.eye(3), Z_AXIS)))
    assert np.all(np.isfinite(shifts_per_ring_bias(points_m, Z_AXIS)))


def test_priors_are_those_of_the_configuration():
    others = {"elevation_bias_sigma_deg": 0.1, "range_scale_sigma": 5e-4, "glancing_bias_sigma_m": 0.007}
    config = RefineConfig(range_bias_sigma_m=0.04, range_bias_sigmas_m={"left": 0.03}, **others)
    assert prior_sigmas("left", config) == pytest.approx([0.03, np.deg2rad(0.1), 5e-4, 0.007])
    assert prior_sigmas("right", config)[0] == 0.04


@pytest.mark.parametrize(("sigmas", "factor"), [(0.0, 1.0), (1.9, 1.0), (-5.0, 2.5), (10.0, 5.0)])
@pytest.mark.parametrize("bias", range(4))
def test_implausible_biases_are_distrusted(bias, sigmas, factor):
    allowed = prior_sigmas("", RefineConfig())
    assert distrust(sigmas * allowed * np.eye(4)[bias], allowed) == pytest.approx(factor)


def test_distrust_goes_along_the_best_way():
    own = {"root": 1.0, "near": 5.0, "beside": 2.0, "behind": 1.0, "last": 3.0}
    chain = [("root", "near"), ("behind", "near"), ("behind", "last")]
    expected = {"root": 1.0, "near": 5.0, "behind": 5.0, "last": 5.0}
    assert distrust_of_chains("root", own, chain) == expected
    around = [*chain, ("root", "beside"), ("behind", "beside"), ("near",)]
    assert distrust_of_chains("root", own, around) == expected | {"beside": 2.0, "behind": 2.0, "last": 3.0}


def _problem(rng, biases_of_data, poses=1, strength=1.0):
    """Information of one coordinate of a pose and of the biases, and its gradient at a state away from the best."""
    scale = strength / np.concatenate([np.full(poses, 0.01), _SIGMAS[: len(biases_of_data)]])
    root = rng.normal(size=(len(scale), len(scale))) * scale[:, None]
    information = root @ root.T
    best = np.concatenate([rng.normal(scale=0.01, size=poses), biases_of_data])
    biases = 0.5 * biases_of_data + 0.1 * _SIGMAS[: len(biases_of_data)]
    state = np.concatenate([rng.normal(scale=0.01, size=poses), biases])
    return information, information @ (state - best), state, best


@pytest.fixture
def many_shares(monkeypatch):
    """Leave out the error of a coarse grid."""
    monkeypatch.setattr(sensor_biases, "_SHARES", np.geomspace(1e-3, 1.0, 300))


@pytest.fixture
def one_kind(monkeypatch):
    """Let all biases have a share in common."""
    monkeypatch.setattr(sensor_biases, "BIAS_COUNT", 1)


@pytest.fixture
def as_drawn(monkeypatch):
    """Leave out what counts more because a rig has few LiDARs, and the least error of a position."""
    monkeypatch.setattr(sensor_biases, "_OF_FEW_LIDARS", 0.0)
    monkeypatch.setattr(sensor_biases, "_SCENE_SIGMA_M", 0.0)


@pytest.mark.usefixtures("many_shares", "as_drawn")
@pytest.mark.parametrize("size", [0.1, 1.0, 2.5], ids=["smaller", "as allowed", "larger"])
@pytest.mark.parametrize("strength", [0.5, 5.0], ids=["weak data", "strong data"])
def test_the_posterior_is_that_of_an_integration(size, strength):
    """Mean and spread of a coordinate and a bias, by a sum over a grid of them and of the share."""
    sigma = _SIGMAS[:1]
    information, gradient, state, best = _problem(np.random.default_rng(1), size * sigma, strength=strength)
    found = posterior(information, gradient, state[1:], sigma)
    spread = np.sqrt(np.diag(np.linalg.inv(information)))
    shares = (np.arange(50) + 0.5) / 50
    units = np.linspace(-6.0, 6.0, 150)
    coordinate = best[0] + spread[0] * np.linspace(-6.0, 6.0, 60)
    weights, moments = 0.0, np.zeros((3, 2))
    for share in shares:
        bias = share * sigma * units
        off = np.stack(np.meshgrid(coordinate - best[0], bias - best[1], indexing="ij"), axis=-1)
        density = np.exp(-0.5 * np.einsum("abi,ij,abj->ab", off, information, off) - 0.5 * units**2)
        values = np.stack(np.broadcast_arrays(coordinate[:, None], bias[None, :]), axis=-1) - state
        weights += density.sum()
        moments[0] += np.einsum("ab,abi->i", density, values)
        moments[1] += np.einsum("ab,abi->i", density, values**2)
    mean = moments[0] / weights
    deviation = np.sqrt(moments[1] / weights - mean**2)
    assert np.all(np.abs(found.step - mean) < 0.03 * deviation)
    np.testing.assert_allclose([np.sqrt(found.covariance[0, 0]), *found.bias_sigmas], deviation, rtol=0.02)


@pytest.mark.usefixtures("one_kind", "as_drawn")
def test_the_grid_of_shares_is_fine_enough():
    """Against a uniform share from 0 to 1 in steps of 0.5 %: a fifth of a sigma, and a third wider at most.

    Principal biases count as independent, so single ones are a little narrower where these mix.
    """
    rng = np.random.default_rng(2)
    for size in (0.02, 0.2, 0.5, 1.0, 2.0):
        information, gradient, state, _ = _problem(rng, size * _SIGMAS * [1.0, 0.5, -0.8, 0.3], strength=5.0)
        found = posterior(information, gradient, state[1:], _SIGMAS)
        of_poses, mixed = information[0, 0], information[0, 1:]
        reduced = information[1:, 1:] - np.outer(mixed, mixed) / of_poses
        best = np.linalg.solve(reduced, reduced @ state[1:] - (gradient[1:] - mixed * gradient[0] / of_poses))
        weights, means, squares = [], [], []
        for share in np.arange(0.0025, 1.0, 0.005):
            prior = np.diag((share * _SIGMAS) ** 2)
            evidence = np.linalg.inv(reduced) + prior
            gain = prior @ np.linalg.inv(evidence)
            log_weight = -0.5 * (np.linalg.slogdet(evidence)[1] + best @ np.linalg.solve(evidence, best))
            weights.append(np.exp(log_weight))
            means.append(gain @ best)
            squares.append(prior - gain @ prior + np.outer(means[-1], means[-1]))
        mean = np.average(means, axis=0, weights=weights)
        sigmas = np.sqrt(np.diag(np.average(squares, axis=0, weights=weights) - np.outer(mean, mean)))
        assert np.all(np.abs(state[1:] + found.step[1:] - mean) < 0.2 * sigmas)
        assert np.all((found.bias_sigmas > 0.8 * sigmas) & (found.bias_sigmas < 1.35 * sigmas))


@pytest.mark.usefixtures("as_drawn")
def test_a_wide_prior_gives_the_plain_solution():
    rng = np.random.default_rng(3)
    information, gradient, state, best = _problem(rng, _SIGMAS, poses=6, strength=10.0)
    found = posterior(information, gradient, state[6:], 1e6 * _SIGMAS)
    covariance = np.linalg.inv(information)
    np.testing.assert_allclose(state + found.step, best, atol=1e-6 * np.sqrt(np.diag(covariance)).min())
    np.testing.assert_allclose(found.covariance, covariance[:6, :6], rtol=1e-6)
    np.testing.assert_allclose(found.bias_sigmas, np.sqrt(np.diag(covariance))[6:], rtol=1e-6)


@pytest.mark.usefixtures("as_drawn")
def test_a_narrow_prior_gives_the_solution_without_biases():
    rng = np.random.default_rng(4)
    information, gradient, _, _ = _problem(rng, _SIGMAS, poses=6)
    found = posterior(information, gradient, np.zeros(BIAS_COUNT), 1e-4 * _SIGMAS)
    expected = -np.linalg.solve(information[:6, :6], gradient[:6])
    np.testing.assert_allclose(found.step, [*expected, *np.zeros(BIAS_COUNT)], atol=1e-5 * np.abs(expected).max())
    # The pseudo-inverse rounds at 1e-15 of a prior that is 1e10 times the information.
    np.testing.assert_allclose(found.covariance, np.linalg.inv(information[:6, :6]), rtol=1e-5)


def test_the_solution_does_not_depend_on_the_linearisation():
    rng = np.random.default_rng(5)
    information, gradient, state, _ = _problem(rng, _SIGMAS, poses=6)
    found = posterior(information, gradient, state[6:], _SIGMAS)
    shift = rng.normal(size=6 + BIAS_COUNT) * np.concatenate([np.full(6, 0.01), _SIGMAS])
    elsewhere = posterior(information, gradient + information @ shift, state[6:] + shift[6:], _SIGMAS)
    np.testing.assert_allclose(shift + elsewhere.step, found.step, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(elsewhere.covariance, found.covariance, rtol=1e-6)


@pytest.mark.usefixtures("as_drawn")
def test_biases_that_the_data_do_not_show_are_those_of_the_prior():
    """No more than what datasheets allow, and in the mean over the shares less."""
    information = np.diag([1e4, *np.full(BIAS_COUNT, 1e-6)])
    found = posterior(information, np.zeros(1 + BIAS_COUNT), np.zeros(BIAS_COUNT), _SIGMAS)
    assert np.all(found.bias_sigmas < _SIGMAS)
    np.testing.assert_allclose(found.bias_sigmas / _SIGMAS, np.sqrt(1.0 / 3.0), rtol=0.3)


def test_no_position_is_known_better_than_ranges_allow():
    """0.7 mm in translation from one scene, none in rotation, and no part of it is random."""
    information = np.diag([*np.full(12, 1e16), *np.ones(BIAS_COUNT)])
    found = posterior(information, np.zeros(12 + BIAS_COUNT), np.zeros(BIAS_COUNT), _SIGMAS, scenes=[1, 4])
    expected = [*np.repeat([0.0, 7e-4], 3), *np.repeat([0.0, 3.5e-4], 3)]
    assert np.array_equal(
        found.covariance[:6, :6],
        posterior(information, np.zeros(12 + BIAS_COUNT), np.zeros(BIAS_COUNT), _SIGMAS).covariance[:6, :6],
    )
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance)), expected, rtol=1e-6, atol=2e-8)
    np.testing.assert_allclose(np.sqrt(np.diag(found.repeatability)), np.full(12, 1e-8), rtol=1e-3)


def test_the_prior_of_lidars_counts_more_than_once(monkeypatch):
    """What it adds to the variance of a pose, not that of their rings."""
    information = np.eye(1 + BIAS_COUNT + 3) + 0.2
    gradient, sigmas = np.zeros(len(information)), np.ones(BIAS_COUNT + 3)

    def variance(spread):
        return posterior(information, gradient, 0.0 * sigmas, sigmas, spread, rings=(1,)).covariance[0, 0]

    def of_prior():
        return variance(0.0 * information)

    counted, all_counted = of_prior(), variance(information)
    monkeypatch.setattr(sensor_biases, "_OF_FEW_LIDARS", 0.0)
    once = of_prior()
    prior = posterior(information, gradient, 0.0 * sigmas, sigmas, rings=(1,)).prior
    of_rings = np.zeros_like(information)
    of_rings[-3:, -3:] = (prior.information + prior.uncertain)[-3:, -3:]
    total = information.copy()
    total[1:, 1:] += prior.information
    rings = (np.linalg.inv(total) @ of_rings @ np.linalg.inv(total))[0, 0]
    assert counted == pytest.approx(rings + 2.5 * (once - rings))
    assert all_counted - counted == pytest.approx(variance(information) - once)


def test_lidars_that_agree_are_better_than_their_datasheets():
    """Six LiDARs whose ranges agree tell that a seventh one's, unseen, is right; not its elevation."""
    off = np.zeros((7, BIAS_COUNT))
    off[:6, 1] = np.tile([1.0, -1.0], 3) * _SIGMAS[1]
    seen = np.repeat([True, False], [6, 1])[:, None]
    precisions = np.where(seen, (0.02 * _SIGMAS) ** -2.0, 1e-6)
    information = np.diag([1.0, *precisions.ravel()])
    truth = np.concatenate([[0.0], off.ravel()])
    found = posterior(information, -information @ truth, np.zeros(7 * BIAS_COUNT), np.tile(_SIGMAS, 7))
    of_range, elevation, *others = found.bias_sigmas[-BIAS_COUNT:] / _SIGMAS
    assert max(of_range, *others) < 0.15
    assert elevation > 0.5


def test_the_mean_azimuth_of_the_rings_is_no_bias():
    """Rings that turn a LiDAR as one rotate its frame, which is what a pose is of."""
    sigmas = np.tile([0.02, 2e-3, 2e-3], 40)
    gradient, information = np.zeros(1 + len(sigmas)), np.zeros((1 + len(sigmas), 1 + len(sigmas)))
    for kind, share in ((1, 1.0), (2, 1.0 / 31.0)):
        row = np.zeros(1 + len(sigmas))
        row[0], row[1 + kind :: 3] = 1.0, 1.0 / 40
        turned = information + 1e12 * np.outer(row, row)
        found = posterior(turned, gradient, np.zeros(len(sigmas)), sigmas, rings=(40,))
        alone = posterior(turned, gradient, np.zeros(len(sigmas)), sigmas, rings=(40,), prior=_independent(found.prior))
        assert found.covariance[0, 0] == pytest.approx(share * alone.covariance[0, 0], rel=0.05)


def _independent(prior):
    """The prior of biases that do not depend on each other, with the same variances but for the common part."""
    information = prior.information - np.where(np.eye(len(prior.information)) > 0, 0.0, prior.information)
    azimuths = np.arange(2, len(information), 3)
    common = prior.information[azimuths[0], azimuths[1]]
    information[azimuths, azimuths] -= common
    return sensor_biases.BiasPrior(information, np.zeros_like(information))


def test_rings_of_each_lidar_are_as_good_as_the_data_say():
    """One LiDAR has rings off by as much as its datasheet allows, the other none; angles have a share of their own."""
    range_m, angle_rad, rings = 0.01, 1e-3, 12
    rng = np.random.default_rng(8)
    off_m, none = rng.choice([-range_m, range_m], rings), np.zeros(rings)
    truth = np.concatenate([np.column_stack([each, none, none]).ravel() for each in (off_m, none)])
    sigmas = np.tile([range_m, angle_rad, angle_rad], 2 * rings)
    information = np.diag([1.0, *(0.1 * sigmas) ** -2.0])
    # The last ring of each LiDAR is not seen at all.
    unseen = 1 + 3 * np.array([rings - 1, 2 * rings - 1])
    for part in range(3):
        information[unseen + part, unseen + part] = 1e-6
    # The pose moves with the range of the unseen rings, or with their azimuth.
    found = []
    for kind in (0, 2):
        for row in unseen:
            mixed = information.copy()
            derivative = np.zeros(len(mixed))
            derivative[[0, row + kind]] = 1.0
            mixed += 1e8 * np.outer(derivative, derivative)
            found.append(posterior(mixed, mixed @ [0.0, *-truth], 0.0 * truth, sigmas, rings=[rings, rings]))
    by_range, by_range_of_other, by_azimuth, _ = (np.sqrt(each.covariance[0, 0]) for each in found)
    assert 0.5 * range_m < by_range < 1.1 * range_m
    assert by_range_of_other < 0.3 * range_m
    assert by_azimuth < 0.3 * angle_rad + 1.1e-4


def test_the_covariance_is_that_of_draws_of_the_gradient():
    """The gradient spreads otherwise than the information says, by random errors and by others."""
    rng = np.random.default_rng(6)
    information, *_ = _problem(rng, _SIGMAS, poses=2, strength=20.0)
    size = len(information)
    root = 0.3 * np.linalg.cholesky(information) @ rng.normal(size=(size, size))
    spread, random = root @ root.T, root[:, :2] @ root[:, :2].T
    found = posterior(information, np.zeros(size), np.zeros(BIAS_COUNT), 1e6 * _SIGMAS, spread, random)
    draws, sigmas = rng.normal(size=(20_000, size)), np.sqrt(np.diag(found.covariance))
    steps, random_steps = (
        np.linalg.solve(information, (part @ draws[:, : part.shape[1]].T))[:2] for part in (root, root[:, :2])
    )
    correlated = np.outer(sigmas, sigmas)
    np.testing.assert_allclose(np.cov(steps) / correlated, found.covariance / correlated, atol=0.05)
    np.testing.assert_allclose(np.cov(random_steps) / correlated, found.repeatability / correlated, atol=0.05)


def test_the_spread_does_not_move_the_solution():
    information, gradient, state, _ = _problem(np.random.default_rng(7), _SIGMAS, poses=6)
    plain = posterior(information, gradient, state[6:], _SIGMAS)
    wide = posterior(information, gradient, state[6:], _SIGMAS, 4.0 * information, information)
    assert np.array_equal(plain.step, wide.step)
    assert np.linalg.eigvalsh(4.0 * plain.covariance - wide.covariance).min() > -1e-6 * np.trace(wide.covariance)
    assert np.linalg.eigvalsh(wide.covariance - plain.covariance).min() > -1e-6 * np.trace(wide.covariance)
    assert np.linalg.eigvalsh(plain.covariance - wide.repeatability).min() > -1e-6 * np.trace(wide.covariance)
