# SPDX-License-Identifier: Apache-2.0
"""The largest clique of a graph."""

import numpy as np
from scipy.sparse import csr_array

from multilica.results import BoolArray, IndexArray
from multilica.solvers.consistency_graph import grow_clique

# Number of greedy cliques, from the nodes with the most neighbours: one is nearly always of the largest size.
_STARTS = 20
# Share of the pairs of nodes that are connected.
_DENSE = 0.5
# Branches of the integer program: those of matches are solved without any, of noise a branch takes seconds.
_BRANCHES = 10


def maximum_clique(graph: BoolArray) -> IndexArray:
    """Find a largest set of nodes that are all connected with each other; of noise, dense and large, a large one.

    A greedy clique is a lower bound. Nodes and edges that cannot belong to a clique as large are removed. If the rest
    is sparse, NetworkX searches the branches; if it is dense, HiGHS solves an integer program. Each is endless where
    the other is fast (docs/decisions/0007-exact-maximum-clique.md). Among cliques of one size, one whose nodes have few
    connections is taken. The library of TEASER++ searches such nodes first, but may take another one.

    Args:
        graph: (M, M) symmetric, M >= 1; the diagonal is ignored.

    Returns:
        Its members in ascending order.
    """
    graph = graph & ~np.eye(len(graph), dtype=np.bool_)
    connections = np.count_nonzero(graph, axis=1)
    starts = np.argsort(-connections, kind="stable")[:_STARTS]
    greedy = max((grow_clique(graph, int(start)) for start in starts), key=len)
    nodes, rest = _within_cliques(graph, len(greedy))
    later = np.argsort(np.lexsort((nodes, connections[nodes])))
    solve = _solve_dense if np.count_nonzero(rest) > _DENSE * rest.size else _search_sparse
    found = nodes[solve(rest, later)]
    return np.sort(greedy) if len(found) < len(greedy) else found


def _within_cliques(graph: BoolArray, size: int) -> tuple[IndexArray, BoolArray]:
    """Keep nodes and edges that may belong to a clique of that size: both ends of an edge need neighbours in common."""
    nodes = np.arange(len(graph), dtype=np.int64)
    while True:
        enough = np.count_nonzero(graph, axis=1) >= size - 1
        if not enough.all():
            nodes, graph = nodes[enough], graph[np.ix_(enough, enough)]
            continue
        connected = graph.astype(np.float32)
        kept = graph & (connected @ connected >= size - 2)
        if np.array_equal(kept, graph):
            return nodes, graph
        graph = kept


def _search_sparse(graph: BoolArray, later: IndexArray) -> IndexArray:
    """Search branches, bounded by colours; of cliques as large, the first when nodes are taken in their order."""
    import networkx as nx

    # Any member counts more than all ranks together, and a rank more than all later ones.
    count = len(graph)
    weights = {node: (1 << count) + (1 << (count - 1 - int(rank))) for node, rank in enumerate(later)}
    searched = nx.from_numpy_array(graph)
    nx.set_node_attributes(searched, weights, "weight")
    clique, _ = nx.max_weight_clique(searched, weight="weight")
    return np.sort(np.array(clique, dtype=np.int64))


def _solve_dense(graph: BoolArray, later: IndexArray) -> IndexArray:
    """Solve the integer program: of each set of nodes without an edge among them, at most one is a member.

    Return the best after `_BRANCHES`, which may be none.
    """
    from scipy.optimize import Bounds, LinearConstraint, milp  # takes a tenth of a second, and `default` needs none

    without = _sets_without_edges(graph)
    if not without:
        return np.arange(len(graph), dtype=np.int64)
    rows = np.repeat(np.arange(len(without)), [len(each) for each in without])
    # All shares that are missing together count less than one member.
    weights = 1.0 - later / (len(graph) + 1.0) ** 2
    incidence = csr_array((np.ones(len(rows)), (rows, np.concatenate(without))), shape=(len(without), len(graph)))
    solved = milp(
        -weights,
        integrality=np.ones(len(graph)),
        bounds=Bounds(0.0, 1.0),
        constraints=LinearConstraint(incidence, -np.inf, 1.0),
        options={"mip_rel_gap": 0.0, "node_limit": _BRANCHES},
    )
    if solved.x is None:
        return np.empty(0, dtype=np.int64)
    return np.flatnonzero(solved.x > 0.5)


def _sets_without_edges(graph: BoolArray) -> list[IndexArray]:
    """Cover all pairs of nodes that no edge connects; large sets make the program easy."""
    apart = ~graph & ~np.eye(len(graph), dtype=np.bool_)
    uncovered, sets = apart.copy(), list[IndexArray]()
    for node in range(len(graph)):
        while len(others := np.flatnonzero(uncovered[node])):
            members = [node, int(others[0])]
            candidates = np.flatnonzero(apart[node] & apart[members[1]])
            while len(candidates):
                members.append(int(candidates[0]))
                candidates = candidates[apart[members[-1], candidates]]
            sets.append(np.array(members, dtype=np.int64))
            uncovered[np.ix_(members, members)] = False
    return sets
