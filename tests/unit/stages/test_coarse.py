# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from multilica.config import CoarseConfig
from multilica.geometry import RigidTransform
from multilica.results import PRIOR, Correspondences
from multilica.stages.coarse import find_hypotheses

_CONFIG = CoarseConfig()
_TRUTH = RigidTransform.from_xyz_rpy("t", "s", [1.0, 0.5, -0.2], [0.1, -0.05, 2.0])
_TURNED = RigidTransform.from_xyz_rpy("t", "s", [-1.0, 0.5, -0.2], [0.1, -0.05, 2.0 - np.pi])
_FAR = RigidTransform.from_xyz_rpy("t", "s", [14.0, -9.0, 0.0], [0.0, 0.0, 1.0])


def _matches(*shares, seed=0):
    """Make the given number of matches of each pose, one pose after the other."""
    rng = np.random.default_rng(seed)
    rows = []
    for pose, count in shares:
        source = rng.uniform([-20, -20, -2], [20, 20, 5], (count, 3))
        normals = rng.normal(size=source.shape)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        rows.append((pose.apply(source), source, pose.rotate(normals), normals))
    target, source, target_normals, source_normals = (np.concatenate(column) for column in zip(*rows, strict=True))
    rows = np.arange(len(source))
    return Correspondences("t", "s", target, source, target_normals, source_normals, np.zeros(len(source)), rows, rows)


def _found(matches, config=_CONFIG, max_baseline_m=15.0, prior=None):
    return find_hypotheses(matches, config, max_baseline_m, prior)


def test_both_poses_of_an_ambiguous_scene_are_kept():
    coarse = _found(_matches((_TRUTH, 60), (_TURNED, 90)))
    assert (coarse.target, coarse.source) == ("t", "s")
    first, second = coarse.hypotheses[:2]
    assert first.T_target_source.distance_to(_TURNED)[0] < 0.01
    assert second.T_target_source.distance_to(_TRUTH)[0] < 0.01
    assert first.score == pytest.approx(90, abs=3)
    assert set(np.flatnonzero(second.inliers)) >= set(range(60))


def test_poses_with_fewer_than_three_matches_are_dropped():
    coarse = _found(_matches((_TRUTH, 150), (_TURNED, 40)))
    assert all(hypothesis.score >= 3 for hypothesis in coarse.hypotheses)


def test_two_matches_determine_no_pose():
    config = CoarseConfig(min_agreeing_matches=1)
    assert _found(_matches((_TRUTH, 2)), config).hypotheses == ()
    assert _found(_matches((_TRUTH, 3)), config).hypotheses != ()


def test_a_smaller_structure_is_found_beside_a_much_larger_one():
    coarse = _found(_matches((_TRUTH, 60), (_TURNED, 280)))
    assert coarse.hypotheses[1].T_target_source.distance_to(_TRUTH)[0] < 0.01


def test_hypotheses_are_distinct_sorted_and_limited():
    config = CoarseConfig(max_hypotheses=5, normal_tolerance_deg=180.0)
    coarse = _found(_matches((_TRUTH, 60), (_TURNED, 60), (_FAR, 200)), config)
    scores = [hypothesis.score for hypothesis in coarse.hypotheses]
    assert 2 <= len(scores) <= 5
    assert scores == sorted(scores, reverse=True)
    for one, other in combinations(coarse.hypotheses, 2):
        metres, radians = one.T_target_source.distance_to(other.T_target_source)
        assert metres > 0.5 or radians > np.deg2rad(5.0)


def test_the_prior_comes_last_and_changes_no_other():
    matches = _matches((_TRUTH, 60), (_TURNED, 90))
    without, coarse = (_found(matches, prior=prior) for prior in (None, _TRUTH))
    *others, claimed = coarse.hypotheses
    assert [one.T_target_source.matrix.tobytes() for one in others] == [
        one.T_target_source.matrix.tobytes() for one in without.hypotheses
    ]
    assert (claimed.origin, claimed.T_target_source) == (PRIOR, _TRUTH)
    assert claimed.score == pytest.approx(60, abs=3)
    assert {one.origin for one in others} == {"cliques"}


def test_the_prior_is_a_hypothesis_without_matches_as_well():
    coarse = _found(_matches((_TRUTH, 2)), prior=_TURNED)
    assert [one.origin for one in coarse.hypotheses] == [PRIOR]


def test_a_prior_beyond_the_baseline_is_no_hypothesis():
    near, far = (_found(_matches((_TRUTH, 60)), prior=pose) for pose in (_TURNED, _FAR))
    assert near.hypotheses[-1].origin == PRIOR
    assert PRIOR not in [one.origin for one in far.hypotheses]


def test_a_pose_beyond_the_baseline_is_no_hypothesis():
    matches = _matches((_FAR, 200))
    near, far = (_found(matches, max_baseline_m=limit) for limit in (15.0, 20.0))
    assert near.hypotheses == ()
    assert far.hypotheses[0].T_target_source.distance_to(_FAR)[0] < 0.01


def test_matches_beyond_the_baseline_are_not_in_the_graph():
    matches = _matches((_TRUTH, 50), (RigidTransform.from_xyz_rpy("t", "s", [100.0, 0.0, 0.0], [0.0, 0.0, 0.0]), 50))
    coarse = _found(matches)
    assert coarse.graph_nodes == 50
    assert 0 < coarse.graph_edges <= 50 * 49 // 2
    assert coarse.hypotheses[0].inliers.shape == (100,)


def test_a_match_with_the_wrong_normal_does_not_agree():
    matches = _matches((_TRUTH, 60))
    flipped = matches.target_normals.copy()
    flipped[:10] *= -1.0
    best = _found(replace(matches, target_normals=flipped)).hypotheses[0]
    assert not best.inliers[:10].any()
    assert best.inliers[10:].all()


def test_matches_of_no_pose_at_all_agree_on_little():
    rng = np.random.default_rng(0)
    normals = np.tile([0.0, 0.0, 1.0], (300, 1))
    points = rng.uniform(-20, 20, (2, 300, 3))
    rows = np.arange(300)
    coarse = _found(Correspondences("t", "s", *points, normals, normals, np.zeros(300), rows, rows))
    assert all(hypothesis.score < 15 for hypothesis in coarse.hypotheses)
