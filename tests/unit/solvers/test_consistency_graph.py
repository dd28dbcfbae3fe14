# SPDX-License-Identifier: Apache-2.0
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.results import Correspondences
from multilica.solvers.consistency_graph import build_consistency_graph, grow_cliques


def _matches(seed, right, wrong):
    """The first `right` matches agree with one pose, the others with none."""
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(random_state=seed).as_matrix()
    source = rng.uniform(-20, 20, (right + wrong, 3))
    normals = rng.normal(size=source.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    target, target_normals = source @ rotation.T + [1.0, 2.0, 3.0], normals @ rotation.T
    target[right:] = rng.uniform(-20, 20, (wrong, 3))
    return Correspondences("t", "s", target, source, target_normals, normals, np.zeros(len(source)))


def _neighbours(graph, index):
    return np.flatnonzero(np.unpackbits(graph.rows[index].view(np.uint8), bitorder="little"))


def test_edges_are_those_of_the_definition():
    matches = _matches(0, 20, 80)
    graph = build_consistency_graph(matches, 0.2, 180.0)
    expected = set()
    for i, j in combinations(range(len(matches)), 2):
        in_target = np.linalg.norm(matches.target_points_m[i] - matches.target_points_m[j])
        in_source = np.linalg.norm(matches.source_points_m[i] - matches.source_points_m[j])
        if abs(in_target - in_source) <= 0.4 and min(in_target, in_source) > 0.4:
            expected.add((i, j))
    found = {(i, int(j)) for i in range(len(matches)) for j in _neighbours(graph, i) if i < j}
    assert found == expected
    assert graph.edges == len(expected)


def test_angles_only_remove_edges():
    matches = _matches(1, 30, 300)
    lengths_only = build_consistency_graph(matches, 0.2, 180.0)
    with_angles = build_consistency_graph(matches, 0.2, 20.0)
    assert np.array_equal(with_angles.rows & lengths_only.rows, with_angles.rows)
    assert with_angles.edges < lengths_only.edges


@pytest.mark.parametrize("seed", range(3))
def test_the_largest_clique_is_correct_with_97_percent_wrong(seed):
    matches = _matches(seed, 30, 970)
    graph = build_consistency_graph(matches, 0.1, 20.0)
    clique = grow_cliques(graph, 20)[0]
    assert set(clique) <= set(range(30))
    assert len(clique) >= 27


def test_cliques_are_complete_subgraphs_and_distinct():
    graph = build_consistency_graph(_matches(2, 20, 200), 0.3, 180.0)
    cliques = grow_cliques(graph, 10)
    assert len({tuple(clique) for clique in cliques}) == len(cliques) > 1
    for clique in cliques:
        assert all(j in _neighbours(graph, i) for i, j in combinations(clique, 2))


def test_no_matches_no_edges():
    graph = build_consistency_graph(_matches(0, 0, 0), 0.2, 180.0)
    assert graph.edges == 0
    assert grow_cliques(graph, 5) == []
