# SPDX-License-Identifier: Apache-2.0
"""Consistency graph of matches, and its cliques: possible sets of inliers."""

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_array

from multilica.geometry import FloatArray
from multilica.results import BoolArray, Correspondences, IndexArray

_Float32Array = npt.NDArray[np.float32]

# Rows of the graph that are computed at once: as many as the processor's cache holds.
_BLOCK = 64

# Number of greedy cliques, from the nodes with the most neighbours: one is nearly always of the largest size.
_STARTS = 20
# Share of the pairs of nodes that are connected.
_DENSE = 0.5
# Branches of the integer program: those of matches are solved without any, of noise a branch takes seconds.
_BRANCHES = 10


def build_consistency_graph(matches: Correspondences, noise_bound_m: float, normal_tolerance_deg: float) -> BoolArray:
    """Connect two matches if lengths and angles that no rigid motion changes are the same in both clouds.

    Lengths: TEASER++ (Yang et al., T-RO 2020, eq. 7), ``| |b_i - b_j| - |a_i - a_j| | <= 2 noise_bound``. Angles:
    between the two normals, between each normal and the line that joins the points (point pair features, Drost et al.,
    CVPR 2010); a tolerance of 180 degrees leaves them out. Matches closer together than the tolerance of lengths
    are never connected: they are consistent under any pose.

    Returns:
        (M, M) symmetric: whether matches i and j are consistent.
    """
    count, tolerance_m = len(matches), np.float32(2.0 * noise_bound_m)
    graph = np.zeros((count, count), dtype=np.bool_)
    target = _PairInvariants(matches.target_points_m, matches.target_normals)
    source = _PairInvariants(matches.source_points_m, matches.source_normals)
    for start in range(0, count, _BLOCK):
        rows, columns = slice(start, start + _BLOCK), slice(start, count)
        target_m, source_m = target.lengths(rows, columns), source.lengths(rows, columns)
        consistent = graph[rows, columns]
        np.less_equal(np.abs(target_m - source_m), tolerance_m, out=consistent)
        consistent &= np.minimum(target_m, source_m) > tolerance_m
        if normal_tolerance_deg < 180.0:
            tolerance = np.float32(np.sin(np.deg2rad(min(normal_tolerance_deg, 90.0))))
            for in_target, in_source in zip(
                target.cosines(rows, columns, target_m), source.cosines(rows, columns, source_m), strict=True
            ):
                consistent &= np.abs(in_target - in_source) <= tolerance
    return np.asarray(np.logical_or(graph, graph.T))


class _PairInvariants:
    """Lengths and cosines between the points of a cloud, as entries of matrix products."""

    def __init__(self, points_m: FloatArray, normals: FloatArray) -> None:
        one, squared = np.ones((len(points_m), 1)), np.sum(points_m**2, axis=1, keepdims=True)
        along = np.sum(points_m * normals, axis=1, keepdims=True)
        self._squared = _factors([-2.0 * points_m, one, squared], [points_m, squared, one])
        self._angles = _factors([normals], [normals])
        self._projections = (
            _factors([-normals, along], [points_m, one]),
            _factors([points_m, one], [normals, -along]),
        )

    def lengths(self, rows: slice, columns: slice) -> _Float32Array:
        left, right = self._squared
        return np.asarray(np.sqrt(np.maximum(left[rows] @ right[:, columns], np.float32(1e-12))))

    def cosines(self, rows: slice, columns: slice, lengths: _Float32Array) -> Iterator[_Float32Array]:
        left, right = self._angles
        yield left[rows] @ right[:, columns]
        for left, right in self._projections:
            yield (left[rows] @ right[:, columns]) / lengths


def _factors(left: Sequence[FloatArray], right: Sequence[FloatArray]) -> tuple[_Float32Array, _Float32Array]:
    """Join columns of (M, ...) arrays to two factors whose product has one entry per pair of points."""
    return np.hstack(left).astype(np.float32), np.ascontiguousarray(np.hstack(right).T, dtype=np.float32)


def grow_clique(graph: BoolArray, seed: int) -> IndexArray:
    """Grow a maximal clique greedily from a match; return its members in ascending order.

    Each step adds, among the matches consistent with the whole clique, the one that leaves the most others.
    """
    members = np.flatnonzero(graph[seed])
    among = graph[members][:, members].astype(np.float32)
    left = np.ones(len(members), dtype=np.float32)
    neighbours = among.sum(axis=0)
    clique, count = [seed], len(members)
    while count:
        chosen = int(neighbours.argmax())
        clique.append(int(members[chosen]))
        gone = np.flatnonzero(left > among[chosen])
        left[gone] = 0.0
        count -= len(gone)
        neighbours -= among[gone].sum(axis=0)
        neighbours[gone] = -np.inf
    return np.array(sorted(clique), dtype=np.int64)


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
