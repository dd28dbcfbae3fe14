# SPDX-License-Identifier: Apache-2.0
"""Consistency graph of matches; its cliques are possible sets of inliers."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray
from multilica.results import Correspondences, IndexArray

__all__ = ["ConsistencyGraph", "build_consistency_graph", "grow_cliques"]

# Rows of the graph that are computed at once: bounds memory.
_BLOCK = 512


@dataclass(frozen=True, slots=True, eq=False)
class ConsistencyGraph:
    """Undirected graph over M matches.

    Args:
        rows: (M, ceil(M / 64)) bit sets: bit j of row i is set if i and j are consistent.
        degrees: (M,) number of neighbours of each match.
    """

    rows: npt.NDArray[np.uint64]
    degrees: IndexArray

    @property
    def edges(self) -> int:
        """Number of undirected edges."""
        return int(self.degrees.sum()) // 2


def build_consistency_graph(
    matches: Correspondences, noise_bound_m: float, normal_tolerance_deg: float
) -> ConsistencyGraph:
    """Connect two matches if lengths and angles that no rigid motion changes are the same in both clouds.

    Lengths: TEASER++ (Yang et al., T-RO 2020, eq. 7), ``| |b_i - b_j| - |a_i - a_j| | <= 2 noise_bound``. Angles:
    between the two normals, between each normal and the line that joins the points (point pair features, Drost et al.,
    CVPR 2010); a tolerance of 180 degrees leaves them out. Matches closer together than the tolerance of lengths
    are never connected: they are consistent under any pose.

    Memory is M * M / 8 bytes and one block of rows at a time.
    """
    count = len(matches)
    words = (count + 63) // 64
    rows = np.zeros((count, words), dtype=np.uint64)
    target = _PairInvariants(matches.target_points_m, matches.target_normals)
    source = _PairInvariants(matches.source_points_m, matches.source_normals)
    for start in range(0, count, _BLOCK):
        block = slice(start, min(start + _BLOCK, count))
        consistent = _consistent_block(target, source, block, 2.0 * noise_bound_m, normal_tolerance_deg)
        padded = np.zeros((consistent.shape[0], words * 64), dtype=bool)
        padded[:, :count] = consistent
        rows[block] = np.packbits(padded, axis=1, bitorder="little").view(np.uint64)
    return ConsistencyGraph(rows, np.bitwise_count(rows).sum(axis=1, dtype=np.int64))


class _PairInvariants:
    """Lengths and cosines between one block of points and all points of a cloud."""

    def __init__(self, points_m: FloatArray, normals: FloatArray) -> None:
        self.points = points_m.astype(np.float32)
        self.normals = normals.astype(np.float32)
        self.along = np.einsum("ij,ij->i", self.points, self.normals)

    def lengths(self, block: slice) -> npt.NDArray[np.float32]:
        offset = self.points[block, None, :] - self.points[None, :, :]
        return np.asarray(np.sqrt(np.einsum("ijk,ijk->ij", offset, offset)))

    def cosines(self, block: slice, lengths: npt.NDArray[np.float32]) -> tuple[npt.NDArray[np.float32], ...]:
        between = self.normals[block] @ self.normals.T
        inverse = 1.0 / np.maximum(lengths, np.float32(1e-6))
        first = (self.along[block, None] - self.normals[block] @ self.points.T) * inverse
        second = (self.points[block] @ self.normals.T - self.along[None, :]) * inverse
        return between, first, second


def _consistent_block(
    target: _PairInvariants, source: _PairInvariants, block: slice, tolerance_m: float, normal_tolerance_deg: float
) -> npt.NDArray[np.bool_]:
    target_lengths, source_lengths = target.lengths(block), source.lengths(block)
    consistent = np.abs(target_lengths - source_lengths) <= tolerance_m
    consistent &= np.minimum(target_lengths, source_lengths) > tolerance_m
    if normal_tolerance_deg < 180.0:
        tolerance = np.float32(np.sin(np.deg2rad(min(normal_tolerance_deg, 90.0))))
        pairs = zip(target.cosines(block, target_lengths), source.cosines(block, source_lengths), strict=True)
        for target_cosine, source_cosine in pairs:
            consistent &= np.abs(target_cosine - source_cosine) <= tolerance
    return np.asarray(consistent)


def grow_cliques(graph: ConsistencyGraph, max_seeds: int) -> list[IndexArray]:
    """Grow maximal cliques greedily, each from a match that no earlier clique contains; return the largest first.

    Each step adds, among the matches consistent with the whole clique, the one that leaves the most others. Seeds are
    tried by falling degree; the largest clique of a graph is nearly always found, the others give further poses.
    """
    covered = np.zeros(len(graph.degrees), dtype=bool)
    cliques: list[IndexArray] = []
    for seed in np.argsort(-graph.degrees, kind="stable"):
        if len(cliques) == max_seeds:
            break
        if covered[seed] or graph.degrees[seed] < 2:
            continue
        clique = _grow(graph.rows, int(seed))
        covered[clique] = True
        cliques.append(clique)
    return sorted(cliques, key=len, reverse=True)


def _grow(rows: npt.NDArray[np.uint64], seed: int) -> IndexArray:
    clique = [seed]
    consistent = rows[seed].copy()
    while True:
        members = np.flatnonzero(np.unpackbits(consistent.view(np.uint8), bitorder="little"))
        if len(members) == 0:
            return np.array(sorted(clique), dtype=np.int64)
        left = np.bitwise_count(rows[members] & consistent).sum(axis=1, dtype=np.int64)
        chosen = int(members[np.argmax(left)])
        clique.append(chosen)
        consistent &= rows[chosen]
