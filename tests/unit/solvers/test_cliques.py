# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.solvers.cliques import align_points, robust_pose


def _matches(seed, count, wrong_share, noise_m=0.05):
    rng = np.random.default_rng(seed)
    rotation, translation = Rotation.random(random_state=seed).as_matrix(), rng.uniform(-5, 5, 3)
    source = rng.uniform(-30, 30, (count, 3))
    target = source @ rotation.T + translation + rng.uniform(-noise_m, noise_m, (count, 3)) / 2
    wrong = rng.random(count) < wrong_share
    target[wrong] = rng.uniform(-30, 30, (wrong.sum(), 3))
    return target, source, rotation, translation, wrong


def _angle_rad(a, b):
    return Rotation.from_matrix(a.T @ b).magnitude()


def test_align_points_is_exact_without_noise():
    target, source, rotation, translation, _ = _matches(0, 10, 0.0, noise_m=0.0)
    found_rotation, found_translation = align_points(target, source)
    assert _angle_rad(found_rotation, rotation) < 1e-9
    assert np.allclose(found_translation, translation, atol=1e-9)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", [12, 120])
def test_robust_pose_survives_a_third_of_wrong_matches(seed, count):
    target, source, rotation, translation, wrong = _matches(seed, count, 0.3)
    found_rotation, found_translation = robust_pose(target, source, 0.1)
    assert _angle_rad(found_rotation, rotation) < np.deg2rad(0.5)
    assert np.linalg.norm(found_translation - translation) < 0.1
    inliers = np.linalg.norm(target - source @ found_rotation.T - found_translation, axis=1) <= 0.1
    assert not np.any(inliers & wrong)
    assert inliers.sum() >= 0.9 * (~wrong).sum()


def test_robust_pose_beats_least_squares_on_outliers():
    target, source, rotation, translation, _ = _matches(3, 200, 0.3)
    least_squares, _ = align_points(target, source)
    found_rotation, found_translation = robust_pose(target, source, 0.1)
    assert _angle_rad(least_squares, rotation) > np.deg2rad(2.0)
    assert _angle_rad(found_rotation, rotation) < np.deg2rad(0.1)
    assert np.linalg.norm(found_translation - translation) < 0.02


def test_without_outliers_robust_pose_is_least_squares():
    target, source, *_ = _matches(4, 20, 0.0)
    expected, found = align_points(target, source), robust_pose(target, source, 0.5)
    assert np.array_equal(expected[0], found[0])
    assert np.array_equal(expected[1], found[1])


def test_matches_without_weight_do_not_count():
    target, source, rotation, translation, wrong = _matches(5, 40, 0.3, noise_m=0.0)
    found_rotation, found_translation = align_points(target, source, np.where(wrong, 0.0, 2.0))
    assert _angle_rad(found_rotation, rotation) < 1e-7
    assert np.allclose(found_translation, translation, atol=1e-9)


def test_a_reflection_is_never_the_answer():
    source = np.random.default_rng(0).normal(size=(30, 3))
    rotation, _ = align_points(source * [1.0, 1.0, -1.0], source)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
