# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.geometry import RigidTransform
from multilica.results import Correspondences
from multilica.solvers.consistency_graph import build_consistency_graph, grow_clique


def _matches(seed, right, wrong):
    """The first `right` matches agree with one pose, the others with none."""
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=seed).as_matrix()
    source = rng.uniform(-20, 20, (right + wrong, 3))
    normals = rng.normal(size=source.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    target, target_normals = source @ rotation.T + [1.0, 2.0, 3.0], normals @ rotation.T
    target[right:] = rng.uniform(-20, 20, (wrong, 3))
    rows = np.arange(len(source))
    return Correspondences("t", "s", target, source, target_normals, normals, np.zeros(len(source)), rows, rows)


def test_edges_are_those_of_the_definition():
    matches = _matches(0, 20, 80)
    graph = build_consistency_graph(matches, 0.2, 180.0)
    expected = set()
    for i, j in combinations(range(len(matches)), 2):
        in_target = np.linalg.norm(matches.target_points_m[i] - matches.target_points_m[j])
        in_source = np.linalg.norm(matches.source_points_m[i] - matches.source_points_m[j])
        if abs(in_target - in_source) <= 0.4 and min(in_target, in_source) > 0.4:
            expected.add((i, j))
    assert {(int(i), int(j)) for i, j in np.argwhere(np.triu(graph))} == expected
    assert np.array_equal(graph, graph.T)
    assert not graph.diagonal().any()


def test_angles_only_remove_edges():
    matches = _matches(1, 30, 300)
    lengths_only = build_consistency_graph(matches, 0.2, 180.0)
    with_angles = build_consistency_graph(matches, 0.2, 20.0)
    assert np.array_equal(with_angles & lengths_only, with_angles)
    assert with_angles.sum() < lengths_only.sum()
    assert with_angles[:30, :30].sum() == lengths_only[:30, :30].sum()


def test_a_turned_normal_loses_the_edges_of_its_match():
    matches = _matches(3, 30, 0)
    normals = matches.source_normals.copy()
    normals[7] *= -1.0
    turned = replace(matches, source_normals=normals)
    before, after = (build_consistency_graph(each, 0.2, 20.0) for each in (matches, turned))
    others = np.arange(30) != 7
    assert np.array_equal(before[np.ix_(others, others)], after[np.ix_(others, others)])
    assert after[7].sum() < 0.5 * before[7].sum()


def test_the_graph_does_not_depend_on_where_the_clouds_lie():
    matches = _matches(4, 100, 100)
    pose = RigidTransform.from_xyz_rpy("far", "t", [60.0, -40.0, 5.0], [0.3, -0.2, 2.0])
    moved_m, normals = pose.apply(matches.target_points_m), pose.rotate(matches.target_normals)
    moved = replace(matches, target="far", target_points_m=moved_m, target_normals=normals)
    here, there = (build_consistency_graph(each, 0.2, 20.0) for each in (matches, moved))
    assert np.mean(here != there) < 1e-4


@pytest.mark.parametrize("seed", range(3))
def test_the_largest_clique_is_correct_with_97_percent_wrong(seed):
    matches = _matches(seed, 30, 970)
    graph = build_consistency_graph(matches, 0.1, 20.0)
    clique = grow_clique(graph, int(graph.sum(axis=1).argmax()))
    assert set(clique) <= set(range(30))
    assert len(clique) >= 27


def test_cliques_are_complete_and_cannot_grow():
    graph = build_consistency_graph(_matches(2, 20, 200), 0.3, 180.0)
    for seed in range(0, 220, 10):
        clique = grow_clique(graph, seed)
        assert seed in clique
        assert all(graph[i, j] for i, j in combinations(clique, 2))
        assert not graph[clique].all(axis=0).any()


def test_a_match_without_neighbours_is_a_clique_of_one():
    assert np.array_equal(grow_clique(np.zeros((5, 5), dtype=np.bool_), 3), [3])


def test_no_matches_no_edges():
    assert build_consistency_graph(_matches(0, 0, 0), 0.2, 180.0).shape == (0, 0)
