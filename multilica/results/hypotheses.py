# SPDX-License-Identifier: Apache-2.0
"""The matches of a pair, with the poses that they suggest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray, RigidTransform

__all__ = [
    "PRIOR",
    "BoolArray",
    "CoarseResult",
    "Correspondences",
    "Hypothesis",
    "IndexArray",
    "PairKey",
    "hypothesis_label",
]

IndexArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
PairKey = tuple[str, str]
"""(target, source): names of the two LiDARs."""
PRIOR = "prior"
"""Origin and name of the hypothesis that was known beforehand."""


@dataclass(frozen=True, slots=True, eq=False)
class Correspondences:
    """Matched points of two LiDARs, best first; row i of each array belongs to match i.

    Args:
        target_points_m, source_points_m: (M, 3), each in its own LiDAR's frame.
        target_normals, source_normals: (M, 3) unit.
        feature_distances: (M,) distance in descriptor space.
    """

    target: str
    source: str
    target_points_m: FloatArray
    source_points_m: FloatArray
    target_normals: FloatArray
    source_normals: FloatArray
    feature_distances: FloatArray

    def __len__(self) -> int:
        return len(self.target_points_m)

    def subset(self, index: IndexArray) -> Correspondences:
        """The matches of those indices."""
        return Correspondences(
            self.target,
            self.source,
            self.target_points_m[index],
            self.source_points_m[index],
            self.target_normals[index],
            self.source_normals[index],
            self.feature_distances[index],
        )


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A pose that a set of matches agrees on.

    Args:
        inliers: (M,) which matches agree; all False where the solver does not tell.
        score: number of agreeing matches; the order in which hypotheses are tried.
        origin: the solver, or `PRIOR`.
    """

    T_target_source: RigidTransform
    inliers: BoolArray
    score: float
    origin: str


def hypothesis_label(index: int, origin: str) -> str:
    """How a hypothesis is called wherever people read it: by its index, or as the prior."""
    return PRIOR if origin == PRIOR else str(index)


@dataclass(frozen=True, slots=True, eq=False)
class CoarseResult:
    """The hypotheses of a pair, the solver's best first; empty if the matches agree on nothing and nothing is known.

    Args:
        hypotheses: that of the prior, if there is one, comes last, so that it changes no other's index.
        graph_nodes, graph_edges: size of the consistency graph; 0 where the solver builds none.
    """

    target: str
    source: str
    hypotheses: tuple[Hypothesis, ...]
    graph_nodes: int = 0
    graph_edges: int = 0
