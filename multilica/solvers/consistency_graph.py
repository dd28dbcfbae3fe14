# SPDX-License-Identifier: Apache-2.0
"""Consistency graph of matches; its cliques are possible sets of inliers."""

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray
from multilica.results import BoolArray, Correspondences, IndexArray

_Float32Array = npt.NDArray[np.float32]

# Rows of the graph that are computed at once: as many as the processor's cache holds.
_BLOCK = 64


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
