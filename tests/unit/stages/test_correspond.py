# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.config import CoarseConfig, CorrespondConfig
from multilica.geometry import RigidTransform
from multilica.results import FeatureCloud
from multilica.stages.correspond import match_features, pair_priority


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


@pytest.mark.parametrize("counts", [(400, 300), (65, 64), (1, 130)])
def test_matches_are_those_of_an_exhaustive_search(counts):
    target, source = _features("t", _random(counts[0])), _features("s", _random(counts[1], seed=3))
    distances = np.linalg.norm(source.descriptors[:, None] - target.descriptors[None], axis=2)
    nearest = distances.argmin(axis=1)
    kept = [row for row, column in enumerate(nearest) if distances[:, column].argmin() == row]
    for mutual, rows in ((False, np.arange(counts[1])), (True, np.array(kept))):
        matches = match_features(target, source, CorrespondConfig(mutual=mutual))
        order = rows[np.argsort(distances[rows, nearest[rows]], kind="stable")]
        assert np.array_equal(matches.source_points_m, source.points_m[order])
        assert np.array_equal(matches.target_points_m, target.points_m[nearest[order]])
        assert matches.feature_distances == pytest.approx(distances[order, nearest[order]])


def test_small_distances_between_large_descriptors_are_found():
    same = 1e4 + np.arange(33.0)
    offsets = np.arange(100.0)[:, None]
    target, source = _features("t", same + offsets), _features("s", same + offsets[::-1] + 0.2, seed=1)
    matches = match_features(target, source, CorrespondConfig())
    assert len(matches) == 100
    assert matches.feature_distances == pytest.approx(0.2 * np.sqrt(33))


def test_of_equal_descriptors_the_first_two_are_matched():
    target, source = _features("t", np.ones((7, 33))), _features("s", np.ones((9, 33)), seed=1)
    matches = match_features(target, source, CorrespondConfig())
    assert np.array_equal(matches.target_points_m, target.points_m[:1])
    assert np.array_equal(matches.source_points_m, source.points_m[:1])


def test_matches_as_close_are_in_the_order_of_the_source():
    values = np.arange(6.0) * 100.0
    target, source = _features("t", _padded(values[::-1])), _features("s", _padded(values + 1.0))
    matches = match_features(target, source, CorrespondConfig())
    assert len({*matches.feature_distances}) == 1
    assert np.array_equal(matches.source_points_m, source.points_m)
    assert np.array_equal(matches.target_points_m, target.points_m[::-1])


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


def _seen_by_both(share, pose, seed=0):
    """Features of two LiDARs, of which the source sees this share of what the target sees."""
    rng = np.random.default_rng(seed)
    target = _features("t", _random(2000, seed))
    target = FeatureCloud("t", target.points_m, _unit(target.normals), target.descriptors)
    other = rng.permutation(2000) >= share * 2000
    back = pose.inverse()
    points, normals = back.apply(target.points_m), back.rotate(target.normals)
    descriptors = target.descriptors + rng.normal(0.0, 1.0, target.descriptors.shape)
    points[other], normals[other] = rng.uniform(-10, 10, (2, other.sum(), 3))
    descriptors[other] = rng.uniform(0, 100, (other.sum(), 33))
    return target, FeatureCloud("s", points, _unit(normals), descriptors)


def _unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _promise(target, source, max_baseline_m=5.0):
    return pair_priority(target, source, CoarseConfig(), max_baseline_m)


def test_a_pair_promises_more_the_more_it_shares():
    pose = RigidTransform.from_xyz_rpy("t", "s", [1.0, 0.5, -0.2], [0.1, -0.05, 2.0])
    promises = [_promise(*_seen_by_both(share, pose)) for share in (0.0, 0.05, 0.2, 0.8)]
    assert promises == sorted(promises)
    assert promises[0] < 15
    assert promises[-1] > 0.8 * 0.8 * 1500
    assert _promise(*_seen_by_both(0.8, pose)) == promises[-1]


def test_poses_beyond_the_baseline_promise_nothing():
    far = RigidTransform.from_xyz_rpy("t", "s", [6.0, 0.5, -0.2], [0.1, -0.05, 2.0])
    clouds = _seen_by_both(0.8, far)
    assert _promise(*clouds) < 15
    assert _promise(*clouds, max_baseline_m=7.0) > 500


@pytest.mark.parametrize("counts", [(0, 0), (0, 5), (5, 0), (1, 1), (2, 2)])
def test_too_few_descriptors_promise_nothing(counts):
    assert _promise(_features("t", _random(counts[0])), _features("s", _random(counts[1]))) == 0.0


@pytest.mark.slow
def test_without_a_limit_matches_are_in_the_order_of_the_source():
    target, source = _seen_by_both(0.8, RigidTransform.identity("t", "s"))
    config = CorrespondConfig(engine="kd_tree", max_keypoints=0, max_matches=0)
    matches = match_features(target, source, config)
    order = [source.points_m.tolist().index(point) for point in matches.source_points_m.tolist()]
    assert order == sorted(order)
    assert len(order) > 1500
    assert len(match_features(target, source, config.model_copy(update={"max_matches": 7}))) == 7


@pytest.mark.parametrize("mutual", [True, False])
def test_both_engines_find_the_same_matches(mutual):
    clouds = _seen_by_both(0.5, RigidTransform.identity("t", "s"))
    found = [
        match_features(*clouds, CorrespondConfig(engine=engine, mutual=mutual, max_matches=0))
        for engine in ("brute_force", "kd_tree")
    ]
    assert np.array_equal(found[0].target_points_m, found[1].target_points_m)
    assert np.array_equal(found[0].source_points_m, found[1].source_points_m)
    assert len(found[0]) > 500
