# SPDX-License-Identifier: Apache-2.0
"""Matches of a pair and the hypotheses that they support."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray, RigidTransform

IndexArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]
PairKey = tuple[str, str]
"""(target, source): names of the two LiDARs."""
PRIOR = "prior"
"""Origin and name of the hypothesis that the prior gives."""
IMPLIED = -1
"""Number of a hypothesis that no search found: other pairs or stops imply it."""
REPEATED = "repeated"
"""Begins the derivation of a pose at which what stands above the ground repeats."""

_SOLVER_WORDS = {"cliques": "clique", "": "hypothesis"}


@dataclass(frozen=True, slots=True, eq=False)
class Correspondences:
    """Matched points of two LiDARs; row i of each array belongs to match i.

    Args:
        target_points_m, source_points_m: (M, 3), each in its own LiDAR's frame.
        target_normals, source_normals: (M, 3) unit.
        feature_distances: (M,) distance in descriptor space.
        target_index, source_index: (M,) rows of `FeatureCloud.points_m`.
    """

    target: str
    source: str
    target_points_m: FloatArray
    source_points_m: FloatArray
    target_normals: FloatArray
    source_normals: FloatArray
    feature_distances: FloatArray
    target_index: IndexArray
    source_index: IndexArray

    def __len__(self) -> int:
        return len(self.target_points_m)

    def subset(self, index: IndexArray) -> Correspondences:
        """Select the matches of those indices."""
        rows = {each.name: getattr(self, each.name)[index] for each in fields(self)[2:]}
        return replace(self, **rows)

    def within_baseline(self, max_baseline_m: float) -> Correspondences:
        """Select the matches whose ranges differ by no more than the distance of the LiDARs."""
        target_range_m = np.linalg.norm(self.target_points_m, axis=1)
        source_range_m = np.linalg.norm(self.source_points_m, axis=1)
        return self.subset(np.flatnonzero(np.abs(target_range_m - source_range_m) <= max_baseline_m))

    def pose(self, rotation: npt.ArrayLike, translation: npt.ArrayLike) -> RigidTransform:
        """Return ``T_target_source`` from its rotation (3, 3) and its translation (3,) or (3, 1)."""
        flat_m = np.asarray(translation, dtype=np.float64).reshape(3)
        return RigidTransform.from_rotation_translation(self.target, self.source, np.asarray(rotation), flat_m)

    def agreeing(self, pose: RigidTransform, noise_bound_m: float, normal_tolerance_deg: float) -> BoolArray:
        """Find which matches (M,) agree with a pose ``T_target_source`` in place and in normal."""
        residual_m = np.linalg.norm(pose.apply(self.source_points_m) - self.target_points_m, axis=1)
        cosine = np.einsum("ij,ij->i", pose.rotate(self.source_normals), self.target_normals)
        return np.asarray((residual_m <= noise_bound_m) & (cosine >= np.cos(np.deg2rad(normal_tolerance_deg))))


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A proposed pose of a pair.

    Args:
        inliers: (M,) which matches agree with it; empty where it does not come from matches.
        score: number of agreeing matches; the order in which hypotheses are tried.
        origin: the solver, or `PRIOR`; "" if the pose came from other pairs.
        index: place among the pair's hypotheses, which derived poses share; -1 if the pose came from other pairs.
        derivation: how it follows from that hypothesis, such as "turned by 180 deg", "repeated after 9.5 m" or
            "slid by +2 m"; of a pose that
            came from other pairs the LiDARs that link it, such as "front-left-rear"; else "".
        evidence: of its visibility score, where that is known.
    """

    T_target_source: RigidTransform
    inliers: BoolArray = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    score: float = 0.0
    origin: str = ""
    index: int = IMPLIED
    evidence: float | None = None
    derivation: str = ""

    @property
    def name(self) -> str:
        """The origin of the pose as text."""
        return pose_name(self.index, self.origin, self.derivation)


def hypothesis_label(index: int, origin: str) -> str:
    """Name a hypothesis for people: by its index, as the prior, or as implied by other pairs."""
    if origin == PRIOR:
        return PRIOR
    return str(index) if index >= 0 else "implied"


def pose_name(index: int, origin: str, derivation: str = "") -> str:
    """Name a pose for people by its origin: "clique 18, turned by 180 deg", "implied by A-B-C", "the prior"."""
    if index < 0 and origin != PRIOR:
        return f"implied by {derivation}" if derivation else "implied by other pairs"
    start = "the prior" if origin == PRIOR else f"{_SOLVER_WORDS.get(origin, origin)} {index}"
    return f"{start}, {derivation}" if derivation else start


@dataclass(frozen=True, slots=True)
class Solution:
    """Poses that matches support by a solver.

    Args:
        poses: ``T_target_source``, the most trusted first.
        graph_edges: of the consistency graph; 0 where the solver builds none.
        clique_size: members of the largest clique that was found; 0 where the solver looks for none.
    """

    poses: tuple[RigidTransform, ...] = ()
    graph_edges: int = 0
    clique_size: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class CoarseResult:
    """The hypotheses of a pair, the solver's best first; empty if the matches support none and there is no prior.

    Args:
        hypotheses: that of the prior, if there is one, comes last.
        graph_nodes, graph_edges: size of the consistency graph; 0 where the solver builds none.
        clique_size: members of its largest clique that was found.
    """

    target: str
    source: str
    hypotheses: tuple[Hypothesis, ...]
    graph_nodes: int = 0
    graph_edges: int = 0
    clique_size: int = 0
