# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.solvers.teaser import decoupled_pose, vote_translation

_NOISE_BOUND_M = 0.35


def _clique(seed, count, wrong):
    """Matches of which the wrong ones are off by up to twice the noise bound, so that they are in the clique."""
    rng = np.random.default_rng(seed)
    rotation, translation = Rotation.random(random_state=seed).as_matrix(), rng.uniform(-3, 3, 3)
    source = rng.uniform(-20, 20, (count, 3))
    target = source @ rotation.T + translation + rng.normal(0, 0.01, (count, 3))
    target[:wrong] += rng.uniform(0.5, 0.7, (wrong, 3))
    return target, source, rotation, translation


@pytest.mark.parametrize("seed", range(5))
def test_a_few_wrong_matches_do_not_matter(seed):
    target, source, rotation, translation = _clique(seed, 30, 3)
    found_rotation, found_translation = decoupled_pose(target, source, _NOISE_BOUND_M)
    assert Rotation.from_matrix(found_rotation.T @ rotation).magnitude() < np.deg2rad(0.3)
    assert np.abs(found_translation - translation).max() < 0.1


def test_without_noise_it_is_exact():
    target, source, rotation, translation = _clique(1, 10, 0)
    target = source @ rotation.T + translation
    found_rotation, found_translation = decoupled_pose(target, source, _NOISE_BOUND_M)
    assert np.allclose(found_rotation, rotation, atol=1e-9)
    assert np.allclose(found_translation, translation, atol=1e-9)


@pytest.mark.parametrize("seed", range(20))
def test_the_vote_has_the_least_cost_of_all_sets(seed):
    offsets = np.random.default_rng(seed).uniform(-1, 1, 9)
    bound = 0.3

    centres = np.arange(-1.3, 1.3, 0.0005)
    near = np.abs(offsets - centres[:, None]) <= bound
    near = near[near.any(axis=1)]
    means = (near * offsets).sum(axis=1) / near.sum(axis=1)
    costs = (near * (offsets - means[:, None]) ** 2).sum(axis=1) + bound * (~near).sum(axis=1)
    least, mean = costs.min(), means[costs.argmin()]
    assert vote_translation(offsets, bound) == pytest.approx(mean, abs=1e-9)
    assert least <= 9 * bound
