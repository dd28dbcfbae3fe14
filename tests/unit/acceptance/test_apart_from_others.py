# SPDX-License-Identifier: Apache-2.0
"""Pairs of a ring beside the poses that the others give."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest

from multilica.acceptance.consistency import doubted_lidars, widened
from multilica.config import RefineConfig
from multilica.geometry import RigidTransform
from multilica.registration.poses import moved
from multilica.results import PairRegistration, Verdict
from multilica.results.placements import LEAST_PROBABILITY
from multilica.stages.refine import refine

_SIGMAS = np.repeat([np.deg2rad(0.04), 0.004], 3)
_BOUND = 22.46  # 99.9 % of chi squared with six degrees of freedom


def _truth(count):
    """LiDARs on a circle of 4 m, in the frame of the first."""
    angles = 2.0 * np.pi * np.arange(count) / count
    return {
        f"l{number}": RigidTransform.from_xyz_rpy(
            "l0", f"l{number}", [2.0 * np.cos(angle) - 2.0, 2.0 * np.sin(angle), 0.0], [0.0, 0.0, angle]
        )
        for number, angle in enumerate(angles)
    }


def _pair(truth, target, source, error):
    pose = moved(truth[target].inverse() @ truth[source], error[:3], error[3:])
    information = np.diag(_SIGMAS**-2.0)
    return PairRegistration(
        target, source, pose, 0.8, 0.03, 1000, None, 10, "small_gicp", information=information,
        verdict=Verdict("accept"),
    )  # fmt: skip


def _ring(count, seed=0, first=(0.0,) * 6):
    """Pairs of neighbours with their errors; the first pair has a further one."""
    rng, truth = np.random.default_rng(seed), _truth(count)
    errors = rng.standard_normal((count, 6)) * _SIGMAS
    errors[0] += first
    names = [*truth]
    pairs = [_pair(truth, names[i], names[(i + 1) % count], errors[i]) for i in range(count)]
    return truth, pairs, refine("l0", truth, pairs, RefineConfig())


@pytest.mark.parametrize("count", [3, 6])
def test_a_wrong_pair_is_as_far_from_the_others_as_it_is_wrong(count):
    _, _, rig = _ring(count, first=np.array([0.0, 0.0, 0.0, 0.1, 0.0, 0.0]))
    found = rig.refinement.pairs[0]
    assert found.after_m < 0.09
    assert found.apart_m == pytest.approx(0.1, abs=0.025)
    assert found.contradicts


def test_a_right_pair_is_as_probable_as_stated():
    probabilities = [_ring(4, seed)[2].refinement.pairs[0].probability for seed in range(80)]
    assert kstest(probabilities, "uniform").pvalue > 0.01


def test_a_pair_without_others_contradicts_nothing():
    truth = _truth(4)
    pairs = [_pair(truth, "l0", name, np.full(6, 0.01)) for name in ("l1", "l2", "l3")]
    rig = refine("l0", truth, pairs, RefineConfig())
    assert [each.probability for each in rig.refinement.pairs] == pytest.approx([1.0] * 3)


def test_a_pair_that_tells_nothing_contradicts_nothing():
    truth, pairs, _ = _ring(4)
    pairs[0] = replace(pairs[0], information=np.diag([0.0, 0.0, 1e6, 0.0, 0.0, 0.0]))
    rig = refine("l0", truth, pairs, RefineConfig())
    assert min(each.probability for each in rig.refinement.pairs) > 0.01


@pytest.mark.parametrize("first", [[0.0, 0.0, 0.0, 0.1, 0.0, 0.0], [0.0, 0.0, 0.015, 0.0, 0.0, 0.0]])
@pytest.mark.parametrize("count", [3, 6])
def test_a_wrong_pair_leaves_all_poses_within_their_sigma(count, first):
    """Also that of a LiDAR that hangs on the ring, 8 m away from it."""
    truth, pairs, _ = _ring(count, first=np.array(first))
    truth["far"] = truth["l1"] @ RigidTransform.from_xyz_rpy("l1", "far", [8.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    pairs.append(_pair(truth, "l1", "far", np.zeros(6)))
    rig = refine("l0", truth, pairs, RefineConfig())
    doubts = doubted_lidars("l0", pairs, rig.refinement.pairs)
    assert doubts.keys() == truth.keys() - {"l0"}
    assert min(each.probability for each in doubts.values()) < LEAST_PROBABILITY
    for name, covariance in widened(rig.covariances, doubts, rig.poses).items():
        off = rig.poses[name].offset_from(truth[name])
        assert off @ np.linalg.solve(covariance, off) < _BOUND
