# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.config import RefineConfig
from multilica.geometry import RigidTransform
from multilica.registration.poses import moved
from multilica.registration.sensor_biases import BIAS_COUNT, posterior, prior_sigmas
from multilica.registration.view_poses import ViewPoses
from multilica.results import BiasInformation, LinkedStops, PairRegistration, Verdict, ViewPair, connected
from multilica.stages.refine import _shares, _State, refine, trusted_pairs
from tests.multi_snapshot import made_drive

_SIGMA_RAD, _SIGMA_M = 1e-4, 2e-3
_INFORMATION = np.diag([_SIGMA_RAD**-2] * 3 + [_SIGMA_M**-2] * 3)
_TRUTH = {
    name: RigidTransform.from_xyz_rpy("T", name, [index, -0.5 * index, 0.2], [0.1 * index, 0.3, -0.7 * index])
    for index, name in enumerate("TABC")
}
_TRUTH["T"] = RigidTransform.identity("T", "T")


# No position is known better.
_LEAST = np.diag([0.0, 0.0, 0.0, 7e-4, 7e-4, 7e-4]) ** 2


def _nudged(pose, turn_rad, shift_m):
    rotation = Rotation.from_rotvec(turn_rad).as_matrix() @ pose.rotation
    return RigidTransform.from_rotation_translation(pose.target, pose.source, rotation, pose.xyz_m + shift_m)


def _pair(target, source, pose, information=_INFORMATION):
    return PairRegistration(
        target=target,
        source=source,
        T_target_source=pose,
        fitness=0.9,
        rmse_m=0.05,
        inliers=1000,
        converged=True,
        iterations=5,
        engine="test",
        information=information,
    )


def _measured(rng, pairs, noise=1.0):
    for target, source in pairs:
        pose = _TRUTH[target].inverse() @ _TRUTH[source]
        turn, shift = noise * _SIGMA_RAD * rng.normal(size=3), noise * _SIGMA_M * rng.normal(size=3)
        yield _pair(target, source, _nudged(pose, turn, shift))


def _started(rng):
    return {
        name: pose if name == "T" else _nudged(pose, rng.normal(size=3) * 0.01, rng.normal(size=3) * 0.05)
        for name, pose in _TRUTH.items()
    }


def _errors(poses):
    return [poses[name].distance_to(_TRUTH[name]) for name in "ABC"]


def test_exact_pairs_give_exact_poses_from_a_rough_start():
    rng = np.random.default_rng(0)
    rig = refine("T", _started(rng), list(_measured(rng, combinations("TABC", 2), noise=0.0)), RefineConfig())
    assert max(metres for metres, _ in _errors(rig.poses)) < 1e-6
    assert max(radians for _, radians in _errors(rig.poses)) < 1e-6
    assert rig.refinement.cycle_error_after.m < 1e-6 < rig.refinement.cycle_error_before.m
    assert np.array_equal(rig.poses["T"].matrix, np.eye(4))


@pytest.mark.slow
@pytest.mark.in_turn
def test_loops_lower_the_error_and_the_covariance_covers_it():
    """Here the noise of the pairs is independent; the covariance allows for pairs that have it in common."""
    normalised, direct, joint = [], [], []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        pairs = list(_measured(rng, combinations("TABC", 2)))
        rig = refine("T", _started(rng), pairs, RefineConfig())
        for name in "ABC":
            pose, truth = rig.poses[name], _TRUTH[name]
            turn = Rotation.from_matrix(pose.rotation @ truth.rotation.T).as_rotvec()
            error = np.concatenate([turn, pose.xyz_m - truth.xyz_m])
            normalised.append(error @ np.linalg.solve(rig.covariances[name], error) / 6)
            joint.append(np.linalg.norm(error[3:]))
        direct += [np.linalg.norm(p.T_target_source.xyz_m - _TRUTH[p.source].xyz_m) for p in pairs if p.target == "T"]
    assert np.mean(joint) < 0.85 * np.mean(direct)
    assert 0.3 < np.mean(normalised) < 1.3


@pytest.mark.parametrize("count", [2, 5, 20, 80])
def test_errors_of_more_snapshots_average_out(count):
    pair = _pair("T", "A", _TRUTH["A"])
    one, many = (refine("T", _TRUTH, [pair] * times, RefineConfig()) for times in (1, count))
    np.testing.assert_allclose(many.covariances["A"], one.covariances["A"] / count, rtol=1e-6)
    np.testing.assert_allclose(many.repeatability["A"], one.repeatability["A"] / count, rtol=1e-6)


@pytest.mark.parametrize(("links", "places"), [("", 4), ("A1-A2", 3), ("A1-A2 A2-A3 A3-A4", 1)])
def test_linked_stops_show_one_place(links, places):
    """The same surfaces leave the same error at each of them."""
    within = [
        replace(each.registration, information=1e6 * _INFORMATION)
        for each in made_drive.pairs("A1-B1 A2-B2 A3-B3 A4-B4")
    ]
    found = made_drive.pairs(links)
    stops = {stop: made_drive.STOPS[stop] for link in found for stop in link.stops}
    linked = LinkedStops(found, stops, frozenset({"stop 1"} & stops.keys()))
    rig = refine("A", {name: made_drive.LIDARS[name] for name in "AB"}, within, RefineConfig(), linked)
    least_m = np.sqrt(np.diag(_LEAST)[3:] / places)
    np.testing.assert_allclose(np.sqrt(np.diag(rig.covariances["B"])[3:]), least_m, rtol=0.01)


def test_one_bad_pair_does_not_bend_the_rig():
    rng = np.random.default_rng(1)
    pairs = list(_measured(rng, combinations("TABC", 2)))
    bad = pairs[3]
    pairs[3] = _pair(bad.target, bad.source, _nudged(bad.T_target_source, [0.0, 0.0, 0.02], [0.3, 0.0, 0.0]))
    start = {name: _TRUTH[name] for name in "TABC"}
    rig = refine("T", start, pairs, RefineConfig())
    assert max(metres for metres, _ in _errors(rig.poses)) < 4 * _SIGMA_M
    weights = [pair.weight for pair in rig.refinement.pairs]
    assert weights[3] < 0.01
    assert min(weights[:3] + weights[4:]) > 0.5


def test_a_chain_has_nothing_to_adjust_and_growing_uncertainty():
    rng = np.random.default_rng(2)
    rig = refine("T", _started(rng), list(_measured(rng, [("T", "A"), ("A", "B"), ("C", "B")])), RefineConfig())
    assert rig.refinement.cycle_error_after.m < 1e-7
    sigma = {name: np.sqrt(np.trace(rig.covariances[name][3:, 3:])) for name in "ABC"}
    assert sigma["A"] < sigma["B"] < sigma["C"]


def test_an_unconnected_lidar_has_no_covariance():
    rig = refine("T", _TRUTH, [_pair("T", "A", _TRUTH["A"]), _pair("T", "B", _TRUTH["B"], None)], RefineConfig())
    assert set(rig.covariances) == {"A"}
    assert rig.poses["B"] is _TRUTH["B"]


@pytest.mark.parametrize(("root", "reached"), [("T", {"T", "A", "B"}), ("C", {"C"})])
def test_connected_follows_chains_in_both_directions(root, reached):
    rng = np.random.default_rng(3)
    assert connected(root, list(_measured(rng, [("B", "A"), ("A", "T")]))) == reached


def test_merges_are_trusted_where_no_pair_connects():
    accepted, open_pair = _pair("T", "A", _TRUTH["A"]), replace(_pair("T", "B", _TRUTH["B"]), verdict=Verdict("reject"))
    known, needed, beside = (_pair(*names, _TRUTH["A"]) for names in ("TA", "TB", "AB"))
    assert trusted_pairs([accepted, open_pair], [(known,), (needed, beside)]) == [accepted, needed, beside]


# Three LiDARs in a loop, whose systematic errors all their pairs share.
_CONFIG = RefineConfig()
_BIAS_SIGMAS = prior_sigmas("", _CONFIG)
_LOOP = {
    "T": RigidTransform.identity("T", "T"),
    "A": RigidTransform.from_xyz_rpy("T", "A", [1.0, -0.5, 0.2], [0.1, 0.3, -0.7]),
    "B": RigidTransform.from_xyz_rpy("T", "B", [-1.0, 0.8, -0.2], [-0.1, 0.2, 1.7]),
}
_BIASES = {"T": [0.02, 0.0, 0.0, 1e-4], "A": [-0.015, 1e-4, -1e-4, -2e-4], "B": [0.005, -2e-4, 1e-4, 0.0]}
_PAIRS = tuple(combinations("TAB", 2))
# Of one of the 60 measurements that a pair consists of.
_NOISE_M = 0.004


def _biased_pair(rng, target, source, biases, noise=1.0):
    """Measurements of a pair that each see a mix of pose and biases, as the points of surfaces do."""
    levers_m = np.array([10.0] * 3 + [1.0] * 3 + 2 * [1.0, 10.0, 10.0, 10.0])
    jacobian = rng.normal(size=(60, len(levers_m))) * levers_m / _NOISE_M
    truth = np.concatenate([np.zeros(6), biases[target], biases[source]])
    information = jacobian.T @ jacobian
    gradient = -jacobian.T @ (jacobian @ truth + noise * rng.normal(size=60))
    alone = posterior(information, gradient, np.zeros(2 * BIAS_COUNT), np.tile(_BIAS_SIGMAS, 2))
    pose = moved(_LOOP[target].inverse() @ _LOOP[source], alone.step[:3], alone.step[3:6])
    of_biases = BiasInformation(
        information, gradient + information @ alone.step, information, information, alone.step[6:]
    )
    return replace(_pair(target, source, pose, np.linalg.inv(alone.covariance)), bias_information=of_biases)


def _loop(seed, biases=_BIASES, noise=1.0):
    rng = np.random.default_rng(seed)
    return [_biased_pair(rng, target, source, biases, noise) for target, source in _PAIRS]


def _refined(pairs, config=_CONFIG, **options):
    return refine("T", _LOOP, pairs, config, **options)


def _shifted(pair, shift_m):
    return replace(pair, T_target_source=moved(pair.T_target_source, np.zeros(3), np.array([shift_m, 0.0, 0.0])))


def _offsets(rig):
    return {name: rig.poses[name].offset_from(_LOOP[name]) for name in "AB"}


def test_exact_pairs_give_exact_poses_and_biases():
    config = RefineConfig(
        range_bias_sigma_m=20.0, elevation_bias_sigma_deg=100.0, range_scale_sigma=2.0, glancing_bias_sigma_m=10.0
    )
    rig = _refined(_loop(0, noise=0.0), config)
    assert max(np.abs(error).max() for error in _offsets(rig).values()) < 1e-7
    for bias in rig.refinement.biases:
        found = [bias.range_m, np.deg2rad(bias.elevation_deg), 1e-6 * bias.range_scale_ppm, bias.glancing_m]
        assert np.allclose(found, _BIASES[bias.lidar], atol=1e-7)
    assert min(pair.probability for pair in rig.refinement.pairs) > 0.999


def test_the_biases_of_a_loop_are_found():
    biases = _refined(_loop(1)).refinement.biases
    assert [bias.lidar for bias in biases] == ["A", "B", "T"]
    for bias in biases:
        assert bias.range_m == pytest.approx(_BIASES[bias.lidar][0], abs=0.004)
        assert abs(bias.range_m - _BIASES[bias.lidar][0]) < 3.5 * bias.range_sigma_m
        assert bias.range_sigma_m < 0.1 * _CONFIG.range_bias_sigma_m
        assert abs(bias.elevation_deg) < 3.5 * _CONFIG.elevation_bias_sigma_deg
        assert bias.elevation_sigma_deg < 1.1 * _CONFIG.elevation_bias_sigma_deg
        assert bias.glancing_sigma_m < 1.1 * _CONFIG.glancing_bias_sigma_m
        assert abs(bias.range_scale_ppm) < 3.5e6 * _CONFIG.range_scale_sigma
        assert 1.0 < bias.range_scale_sigma_ppm < 1.1e6 * _CONFIG.range_scale_sigma


@pytest.mark.parametrize(("lidar", "wider"), [("A", "A"), ("T", "AB")])
def test_an_implausible_bias_widens_the_covariance(lidar, wider):
    usual = _refined(_loop(1)).covariances
    rig = _refined(_loop(1, biases=_BIASES | {lidar: [0.1, 0.0, 0.0, 0.0]}))
    largest = max(abs(bias.range_m) for bias in rig.refinement.biases if bias.lidar == lidar)
    for name in "AB":
        factor = 0.5 * largest / _CONFIG.range_bias_sigma_m if name in wider else 1.0
        growth = np.sqrt(np.trace(rig.covariances[name][3:, 3:]) / np.trace(usual[name][3:, 3:]))
        assert growth == pytest.approx(factor, rel=0.3)


def test_the_prior_of_a_lidar_is_its_own():
    config = RefineConfig(range_bias_sigmas_m={"A": 1e-6})
    biases = {bias.lidar: bias for bias in _refined(_loop(1), config).refinement.biases}
    assert abs(biases["A"].range_m) < 1e-5
    assert biases["A"].range_sigma_m < 2e-6
    assert biases["T"].range_sigma_m > 1e-4


def test_a_loop_knows_its_biases_better_than_a_pair():
    pairs = _loop(2)
    of_pair, of_loop = (
        {bias.lidar: bias.range_sigma_m for bias in _refined(chosen).refinement.biases} for chosen in (pairs[:1], pairs)
    )
    assert set(of_pair) == {"T", "A"}
    assert all(of_loop[name] < 0.9 * of_pair[name] for name in of_pair)


def test_a_single_pair_keeps_its_pose_and_covariance():
    pair = _loop(3)[0]
    rig = _refined([pair])
    assert np.allclose(rig.poses["A"].offset_from(pair.T_target_source), 0.0, atol=1e-6)
    assert np.allclose(rig.covariances["A"], np.linalg.inv(pair.information), rtol=1e-3)
    found = pair.bias_information
    known = posterior(
        found.information, found.gradient, found.biases, np.tile(_BIAS_SIGMAS, 2), found.spread, found.random_spread
    )
    assert np.allclose(rig.repeatability["A"], known.repeatability, rtol=1e-3)
    assert rig.refinement.pairs[0].probability > 0.3


def test_random_errors_are_a_part_of_all():
    rig = _refined(_loop(4))
    assert set(rig.repeatability) == {"A", "B"}
    for name in "AB":
        difference = rig.covariances[name] - rig.repeatability[name]
        assert np.linalg.eigvalsh(difference).min() > -1e-3 * np.linalg.eigvalsh(rig.covariances[name]).max()
        assert np.trace(rig.repeatability[name]) < np.trace(rig.covariances[name])


def test_systematic_errors_do_not_make_random_errors_larger():
    """A pair is off by two of its sigmas, which are twenty of its random ones."""
    information = np.diag([1e8] * 3 + [0.005**-2] * 3 + [1e-6] * 2 * BIAS_COUNT)
    random = information * np.repeat([1.0, 0.01, 1.0], [3, 3, 2 * BIAS_COUNT])
    none = np.zeros(len(information))
    of_biases = BiasInformation(information, none, information, random, none[6:])
    pairs = [replace(pair, information=information[:6, :6], bias_information=of_biases) for pair in _loop(5, noise=0.0)]
    even, uneven = (_refined([*pairs[:2], last]) for last in (pairs[2], _shifted(pairs[2], 0.02)))
    for name in "AB":
        assert np.allclose(np.diag(uneven.repeatability[name]), np.diag(even.repeatability[name]), rtol=0.3)
        assert np.all(np.diag(uneven.repeatability[name])[3:] < 0.02 * np.diag(uneven.covariances[name])[3:])


def test_all_errors_of_a_pair_without_biases_are_random():
    pairs = [replace(pair, bias_information=None) for pair in _loop(6)]
    alone, together = _refined(pairs[:1]), _refined(pairs)
    np.testing.assert_allclose(alone.repeatability["A"] + _LEAST, alone.covariances["A"], rtol=1e-6)
    np.testing.assert_allclose(together.repeatability["B"] + _LEAST, together.covariances["B"], rtol=1e-6)


def test_consistent_pairs_are_probable():
    """Each is about as likely as any other; six degrees of freedom are what a loop of three leaves, or a few less."""
    probabilities = [[pair.probability for pair in _refined(_loop(seed)).refinement.pairs] for seed in range(12)]
    assert np.min(probabilities) > 0.001
    assert 0.3 < np.mean(probabilities) < 0.98
    weights = [pair.weight for pair in _refined(_loop(7)).refinement.pairs]
    assert min(weights) > 0.7


def test_a_pair_that_is_wrong_is_improbable():
    pairs = _loop(8)
    pairs[2] = _shifted(pairs[2], 0.05)
    residuals = _refined(pairs).refinement.pairs
    assert residuals[2].probability < 1e-6
    assert residuals[2].weight < min(residuals[0].weight, residuals[1].weight)


def test_a_pair_that_is_wrong_does_not_bend_a_rig_of_four():
    truth, biases = {**_LOOP, "C": _nudged_corner()}, {**_BIASES, "C": [0.0] * BIAS_COUNT}
    rng = np.random.default_rng(9)
    pairs = []
    for target, source in combinations("TABC", 2):
        pair = _biased_pair(rng, "T", "A", {"T": biases[target], "A": biases[source]})
        offset = pair.T_target_source.offset_from(_LOOP["A"])
        pose = moved(truth[target].inverse() @ truth[source], offset[:3], offset[3:])
        pairs.append(replace(pair, target=target, source=source, T_target_source=pose))
    pairs[3] = _shifted(pairs[3], 0.05)
    rig = refine("T", truth, pairs, _CONFIG)
    assert max(rig.poses[name].distance_to(truth[name])[0] for name in "ABC") < 0.004
    probabilities = [pair.probability for pair in rig.refinement.pairs]
    assert probabilities[3] < 1e-6
    assert min(probabilities[:3] + probabilities[4:]) > 1e-3


def _nudged_corner():
    return RigidTransform.from_xyz_rpy("T", "C", [0.5, 1.5, 0.3], [0.0, -0.1, 2.9])


def test_a_pair_of_groups_has_no_biases():
    """Its pose counts; the biases come from the others."""
    pairs = _loop(10)
    rig = _refined([*pairs[:2], replace(pairs[2], bias_information=None)])
    assert [bias.lidar for bias in rig.refinement.biases] == ["A", "B", "T"]
    without = _refined([replace(pair, bias_information=None) for pair in pairs])
    assert without.refinement.biases == ()
    assert set(without.covariances) == {"A", "B"}


def test_snapshots_share_biases():
    """The same three LiDARs five times: each bias is told once, is known better, and is found better."""
    snapshots = [_loop(seed) for seed in range(20, 25)]
    off_m, sigmas_m = [], []
    for chosen in (*snapshots, [pair for pairs in snapshots for pair in pairs]):
        biases = _refined(chosen).refinement.biases
        assert [bias.lidar for bias in biases] == ["A", "B", "T"]
        off_m.append(np.linalg.norm([bias.range_m - _BIASES[bias.lidar][0] for bias in biases]))
        sigmas_m.append([bias.range_sigma_m for bias in biases])
    assert off_m[-1] < 0.7 * np.mean(off_m[:-1])
    assert np.all(np.array(sigmas_m[-1]) < 0.9 * np.mean(sigmas_m[:-1], axis=0))


@pytest.mark.slow
def test_the_covariance_of_a_loop_covers_its_errors():
    squared = []
    for seed in range(60):
        rng = np.random.default_rng((seed, 1))
        rig = _refined(_loop(seed, {name: rng.normal(size=BIAS_COUNT) * _BIAS_SIGMAS for name in "TAB"}))
        squared += [error @ np.linalg.solve(rig.covariances[name], error) for name, error in _offsets(rig).items()]
    assert 3.0 < np.mean(squared) < 9.0


def test_pairs_apart_from_the_target_are_left_out():
    """They have no unknown pose."""
    joined, apart = (_pair(*names, _TRUTH[names[0]].inverse() @ _TRUTH[names[1]]) for names in ("TA", "BC"))
    rig = refine("T", dict(_TRUTH), [joined, apart], RefineConfig())
    assert rig.covariances.keys() == {"A"}
    assert len(rig.refinement.pairs) == 1


def test_a_pair_counts_once_per_snapshot_whichever_is_the_target():
    """The narrower of two LiDARs is the source, which may differ between snapshots."""
    pose = _TRUTH["A"].inverse() @ _TRUTH["B"]
    same, turned = _pair("A", "B", pose), _pair("B", "A", pose.inverse())
    views = ViewPoses(dict(_TRUTH), {}, ["A", "B"], [])
    shares = _shares(
        [ViewPair(each, "", "") for each in (same, turned)], _State(views, np.zeros(0), {}), RefineConfig()
    )
    assert [share.snapshots for _, share in shares] == [2, 2]
