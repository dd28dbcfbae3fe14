# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.solvers.robust_pose import align_points, gnc_tls_rotations, robust_poses, tls_translation


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
    ((found_rotation, found_translation),) = robust_poses([(target, source)], 0.1)
    assert _angle_rad(found_rotation, rotation) < np.deg2rad(0.5)
    assert np.linalg.norm(found_translation - translation) < 0.1
    inliers = np.linalg.norm(target - source @ found_rotation.T - found_translation, axis=1) <= 0.1
    assert not np.any(inliers & wrong)
    assert inliers.sum() >= 0.9 * (~wrong).sum()


def test_gnc_rotation_beats_least_squares_on_outliers():
    rng = np.random.default_rng(3)
    rotation = Rotation.random(random_state=3).as_matrix()
    source = rng.normal(size=(200, 3)) * 10
    target = source @ rotation.T
    target[:60] = rng.normal(size=(60, 3)) * 10
    assert _angle_rad(gnc_tls_rotations([(target, source)], 0.1)[0], rotation) < 1e-3


def test_sets_of_matches_do_not_disturb_each_other():
    sets = [_matches(seed, count, share)[:2] for seed, (count, share) in enumerate([(12, 0.3), (60, 0.3), (4, 0.0)])]
    together = robust_poses(sets, 0.1)
    for each, (rotation, translation) in zip(sets, together, strict=True):
        ((alone_rotation, alone_translation),) = robust_poses([each], 0.1)
        assert np.allclose(rotation, alone_rotation, atol=1e-9)
        assert np.allclose(translation, alone_translation, atol=1e-9)
    assert robust_poses([], 0.1) == []


def test_tls_translation_takes_what_most_agree_on():
    offsets = np.concatenate([np.full((60, 3), [1.0, 2.0, 3.0]), np.random.default_rng(0).uniform(-50, 50, (40, 3))])
    assert np.allclose(tls_translation(offsets, 0.1), [1.0, 2.0, 3.0], atol=0.05)
