# SPDX-License-Identifier: Apache-2.0
from itertools import combinations

import numpy as np
import pytest

from multilica.solvers import consistency_graph as module
from multilica.solvers.consistency_graph import grow_clique, maximum_clique


def _graph(count, edges):
    graph = np.zeros((count, count), dtype=bool)
    for one, other in edges:
        graph[one, other] = graph[other, one] = True
    return graph


def _random(seed, count, share):
    graph = np.triu(np.random.default_rng(seed).random((count, count)) < share, 1)
    return graph | graph.T


def _is_clique(graph, members):
    return all(graph[one, other] for one, other in combinations(members, 2))


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("seed", range(5))
def test_no_clique_is_larger(seed, share):
    graph = _random(seed, 14, share)
    found = maximum_clique(graph)
    assert found.tolist() == sorted(found)
    assert _is_clique(graph, found)
    assert not any(_is_clique(graph, members) for members in combinations(range(14), len(found) + 1))


def test_it_is_larger_than_any_greedy_clique():
    """Ten hubs, each consistent with many others that are not with each other, hide a clique of six."""
    hidden = list(combinations(range(6), 2))
    hubs = [(hub, 16 + 8 * (hub - 6) + spoke) for hub in range(6, 16) for spoke in range(8)]
    between = list(combinations(range(6, 11), 2))
    graph = _graph(96, [*hidden, *hubs, *between])
    assert max(len(grow_clique(graph, hub)) for hub in range(6, 16)) == 5
    assert maximum_clique(graph).tolist() == list(range(6))


def test_of_two_as_large_the_one_with_fewer_connections_is_taken():
    triangles = [(0, 1), (1, 2), (0, 2), (3, 4), (4, 5), (3, 5)]
    assert maximum_clique(_graph(9, [*triangles, (0, 6), (1, 7), (2, 8)])).tolist() == [3, 4, 5]
    assert maximum_clique(_graph(9, [*triangles, (3, 6), (4, 7), (5, 8)])).tolist() == [0, 1, 2]
    assert maximum_clique(_graph(6, triangles)).tolist() == [0, 1, 2]


def test_without_edges_a_single_node_is_the_largest():
    assert maximum_clique(_graph(3, [])).tolist() == [0]
    assert maximum_clique(np.eye(3, dtype=bool)).tolist() == [0]


def test_noise_without_an_end_gives_a_large_clique(monkeypatch):
    monkeypatch.setattr(module, "_BRANCHES", 0)
    graph = _random(3, 90, 0.75)
    found = maximum_clique(graph)
    assert _is_clique(graph, found)
    assert len(found) >= 13
    monkeypatch.setattr(module, "_solve_dense", lambda *_: np.empty(0, dtype=np.int64))
    greedy = maximum_clique(graph)
    assert _is_clique(graph, greedy)
    assert 13 <= len(greedy) <= len(found)
