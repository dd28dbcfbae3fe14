# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.config import RefineConfig
from multilica.geometry import RigidTransform
from multilica.results import PairRegistration, Verdict, connected
from multilica.stages.refine import refine, trusted_pairs

_SIGMA_RAD, _SIGMA_M = 1e-4, 2e-3
_INFORMATION = np.diag([_SIGMA_RAD**-2] * 3 + [_SIGMA_M**-2] * 3)
_TRUTH = {
    name: RigidTransform.from_xyz_rpy("T", name, [index, -0.5 * index, 0.2], [0.1 * index, 0.3, -0.7 * index])
    for index, name in enumerate("TABC")
}
_TRUTH["T"] = RigidTransform.identity("T", "T")


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


def test_pairs_of_one_source_share_its_noise():
    pairs = [_pair(target, "C", _TRUTH[target].inverse() @ _TRUTH["C"]) for target in "TAB"]
    certain = [_pair("T", name, _TRUTH[name], 1e6 * _INFORMATION) for name in "AB"]
    alone = refine("T", _TRUTH, pairs[:1], RefineConfig()).covariances["C"]
    together = refine("T", _TRUTH, [*pairs, *certain], RefineConfig()).covariances["C"]
    assert np.allclose(np.diag(together)[3:], np.diag(alone)[3:], rtol=0.3)
    apart = refine("T", _TRUTH, [*pairs, *certain], RefineConfig(), ["one", "two", "three", "one", "one"]).covariances[
        "C"
    ]
    assert np.allclose(np.diag(apart)[3:], np.diag(alone)[3:] / 3, rtol=0.3)
    others = [_pair("C", name, _TRUTH["C"].inverse() @ _TRUTH[name]) for name in "AB"]
    better = refine("T", _TRUTH, [*pairs[:1], *others, *certain], RefineConfig()).covariances["C"]
    assert np.all(np.diag(better)[3:] < 0.6 * np.diag(alone)[3:])


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
    merges = [_pair("T", "A", _TRUTH["A"]), _pair("T", "B", _TRUTH["B"])]
    assert trusted_pairs([accepted, open_pair], merges) == [accepted, merges[1]]
