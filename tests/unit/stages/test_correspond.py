# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.config import CorrespondConfig
from multilica.results import FeatureCloud
from multilica.stages.correspond import match_features


def _features(lidar, descriptors, seed=0):
    descriptors = np.asarray(descriptors, dtype=np.float64)
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(len(descriptors), 3))
    return FeatureCloud(lidar, rng.uniform(-10, 10, (len(descriptors), 3)), normals, descriptors)


def _padded(values):
    descriptors = np.zeros((len(values), 33))
    descriptors[:, 0] = values
    return descriptors


def _random(count, seed=0):
    return np.random.default_rng(seed).uniform(0, 100, (count, 33))


def test_shuffled_descriptors_match_the_closest_first():
    target = _features("t", _random(200))
    order = np.random.default_rng(1).permutation(200)
    noise = np.linspace(0.0, 1.0, 200)[:, None] * np.ones(33)
    source = _features("s", target.descriptors[order] + noise, seed=2)
    matches = match_features(target, source, CorrespondConfig())
    assert (matches.target, matches.source, len(matches)) == ("t", "s", 200)
    assert np.array_equal(matches.target_points_m, target.points_m[order])
    assert np.array_equal(matches.source_points_m, source.points_m)
    assert np.array_equal(matches.target_normals, target.normals[order])
    assert np.array_equal(matches.source_normals, source.normals)
    assert np.allclose(matches.feature_distances, np.sqrt(33) * noise[:, 0], atol=1e-6)


def test_mutual_keeps_only_mutual_nearest_neighbours():
    target, source = _features("t", _padded([0.0, 10.0])), _features("s", _padded([1.0, 2.0, 9.0]), seed=1)
    mutual = match_features(target, source, CorrespondConfig())
    every = match_features(target, source, CorrespondConfig(mutual=False))
    assert np.array_equal(mutual.source_points_m, source.points_m[[0, 2]])
    assert np.array_equal(every.source_points_m, source.points_m[[0, 2, 1]])
    assert every.feature_distances == pytest.approx([1.0, 1.0, 2.0])


def test_only_the_best_so_many_matches_are_kept():
    target, source = _features("t", _random(300)), _features("s", _random(300, seed=5))
    every = match_features(target, source, CorrespondConfig(mutual=False))
    best = match_features(target, source, CorrespondConfig(mutual=False, max_matches=25))
    assert len(every) == 300
    assert np.array_equal(best.feature_distances, every.feature_distances[:25])
    assert np.all(np.diff(best.feature_distances) >= 0)


def test_too_many_descriptors_are_drawn_evenly_and_always_alike():
    target = _features("t", _random(500))
    config = CorrespondConfig(max_keypoints=100)
    first, second = (match_features(target, target, config) for _ in range(2))
    assert len(first) == 100
    assert np.array_equal(first.source_points_m, second.source_points_m)
    index = [np.flatnonzero((target.points_m == point).all(axis=1))[0] for point in first.source_points_m]
    assert min(index) < 50
    assert max(index) > 450


@pytest.mark.parametrize("counts", [(0, 0), (0, 5), (5, 0)])
@pytest.mark.parametrize("mutual", [True, False])
def test_without_descriptors_there_are_no_matches(counts, mutual):
    target, source = _features("t", _random(counts[0])), _features("s", _random(counts[1]))
    matches = match_features(target, source, CorrespondConfig(mutual=mutual))
    assert len(matches) == 0
    assert matches.target_points_m.shape == (0, 3)
