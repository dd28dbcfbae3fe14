# SPDX-License-Identifier: Apache-2.0
"""Merge decisions, groups of placed LiDARs and the joint refinement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from multilica.geometry import RigidTransform


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """LiDARs whose poses relative to each other are known.

    Args:
        root: the member whose frame is the group's.
        poses: per member ``T_root_member``, the root with the identity.
    """

    root: str
    poses: Mapping[str, RigidTransform]

    @classmethod
    def of_one(cls, name: str) -> Group:
        """Create the group of a single LiDAR."""
        return cls(name, {name: RigidTransform.identity(name, name)})

    @property
    def members(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(sorted(self.poses))

    def joined(self, other: Group, T_root_other: RigidTransform) -> Group:
        """Return this group with another one's members added."""
        added = {name: T_root_other @ pose for name, pose in other.poses.items()}
        return Group(self.root, {**self.poses, **added})

    def pose_of(self, other: Group, known: RigidTransform) -> RigidTransform:
        """Return the pose of the other group's root in this one's, from a pose between two of their members."""
        if known.target in other.poses:
            known = known.inverse()
        return self.poses[known.target] @ known @ other.poses[known.source].inverse()


@dataclass(frozen=True, slots=True)
class MergeCandidate:
    """A pair that a merge step could have chosen.

    Args:
        reason: why it does not pass.
        uncertain: whether it is merged where no pair passes.
        of_groups: whether the merged clouds of two groups were registered; target and source are their roots.
    """

    target: str
    source: str
    fitness: float
    rmse_m: float
    passes: bool
    evidence: float = 0.0
    reason: str = ""
    uncertain: bool = False
    of_groups: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class MergeDecision:
    """One step of the merge.

    Args:
        step: from 0.
        candidates: what could have been chosen, best first.
        chosen: the pair that was merged; None when merging stopped.
        reason: why, in one sentence with its figures.
        groups: members of every connected group after the step, largest first.
    """

    step: int
    candidates: tuple[MergeCandidate, ...]
    chosen: MergeCandidate | None
    reason: str
    groups: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class PairResidual:
    """Disagreement of the rig's poses with one registered pair, before and after the joint refinement.

    Args:
        weight: final weight of the pair, from 1 down to 0 for an outlier.
        snapshot: name of the pair's snapshot; empty where there is only one.
    """

    target: str
    source: str
    before_m: float
    before_deg: float
    after_m: float
    after_deg: float
    weight: float
    snapshot: str = ""


@dataclass(frozen=True, slots=True)
class Refinement:
    """Residuals of the joint refinement; without loops there is nothing to adjust."""

    pairs: tuple[PairResidual, ...] = ()

    @property
    def cycle_error_m(self) -> tuple[float, float]:
        """Largest disagreement in metres before and after."""
        before_m, after_m = [pair.before_m for pair in self.pairs], [pair.after_m for pair in self.pairs]
        return max(before_m, default=0.0), max(after_m, default=0.0)

    @property
    def cycle_error_deg(self) -> tuple[float, float]:
        """Largest disagreement in degrees before and after."""
        before_deg, after_deg = [pair.before_deg for pair in self.pairs], [pair.after_deg for pair in self.pairs]
        return max(before_deg, default=0.0), max(after_deg, default=0.0)
