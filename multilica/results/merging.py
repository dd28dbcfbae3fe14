# SPDX-License-Identifier: Apache-2.0
"""Merge decisions, groups of placed LiDARs and the joint refinement."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from multilica.geometry import RigidTransform
from multilica.results.values import Figure, Source, Target


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
    def of_one(cls, name: str) -> "Group":
        """Create the group of a single LiDAR."""
        return cls(name, {name: RigidTransform.identity(name, name)})

    @property
    def members(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(sorted(self.poses))

    def joined(self, other: "Group", T_root_other: RigidTransform) -> "Group":
        """Return this group with another one's members added."""
        added = {name: T_root_other @ pose for name, pose in other.poses.items()}
        return Group(self.root, {**self.poses, **added})

    def pose_of(self, other: "Group", known: RigidTransform) -> RigidTransform:
        """Return the pose of the other group's root in this one's, from a pose between two of their members."""
        if known.target in other.poses:
            known = known.inverse()
        return self.poses[known.target] @ known @ other.poses[known.source].inverse()


@dataclass(frozen=True, slots=True)
class MergeCandidate:
    """A pair that a merge step could have chosen."""

    target: Target
    source: Source
    fitness: Annotated[
        Figure, Field(description="Share of the source points that lie near a surface of the target cloud.")
    ]
    rmse_m: Annotated[Figure, Field(description="RMS distance of those points to their nearest target point.")]
    passes: Annotated[bool, Field(description="True if the pair may be merged.")]
    evidence: Annotated[Figure, Field(description="Evidence of the pair's registration.")] = 0.0
    reason: Annotated[str, Field(description="Reason why the pair does not pass; empty if it does.")] = ""
    uncertain: Annotated[bool, Field(description="True if the pair may be merged only where no other pair passes.")] = (
        False
    )
    of_groups: Annotated[
        bool,
        Field(description="True if the merged clouds of two groups were registered; the names are their roots."),
    ] = False

    @property
    def names(self) -> frozenset[str]:
        """Target and source, without order."""
        return frozenset((self.target, self.source))


@dataclass(frozen=True, slots=True)
class MergeDecision:
    """One merge step."""

    step: Annotated[int, Field(description="Number of the step, from 0.")]
    candidates: Annotated[
        tuple[MergeCandidate, ...], Field(description="Pairs that could have been chosen, the best first.")
    ]
    chosen: Annotated[
        MergeCandidate | None, Field(description="The pair that was merged; null if the merge stopped here.")
    ]
    reason: Annotated[str, Field(description="Reason for the decision, with its figures.")]
    groups: Annotated[
        tuple[tuple[str, ...], ...], Field(description="Connected LiDARs after the step, the largest group first.")
    ]


@dataclass(frozen=True, slots=True)
class PairResidual:
    """Disagreement of the poses with one registered pair, before and after the refinement."""

    target: Target
    source: Source
    before_m: Annotated[Figure, Field(description="Distance before.")]
    before_deg: Annotated[Figure, Field(description="Angle before.")]
    after_m: Annotated[Figure, Field(description="Distance after.")]
    after_deg: Annotated[Figure, Field(description="Angle after.")]
    weight: Annotated[float, Field(description="Final weight of the pair: 1 for full trust, 0 for an outlier.")]
    snapshot: Annotated[str, Field(description="Snapshot of the pair; empty for a single snapshot.")] = ""


@dataclass(frozen=True, slots=True)
class CycleError:
    """Largest disagreement of the poses with a registered pair."""

    m: Annotated[Figure, Field(description="Distance.")]
    deg: Annotated[Figure, Field(description="Angle.")]


@dataclass(frozen=True, slots=True)
class Refinement:
    """The joint refinement over all accepted pairs."""

    cycle_error_before: Annotated[CycleError, Field(description="Largest disagreement before.")]
    cycle_error_after: Annotated[CycleError, Field(description="Largest disagreement after.")]
    pairs: Annotated[tuple[PairResidual, ...], Field(description="Disagreement per pair.")]

    @classmethod
    def of(cls, pairs: tuple[PairResidual, ...] = ()) -> "Refinement":
        """Create from the residuals of the pairs; without loops there are none, and nothing to adjust."""
        figures = [(pair.before_m, pair.before_deg, pair.after_m, pair.after_deg) for pair in pairs]
        before_m, before_deg, after_m, after_deg = map(max, zip((0.0,) * 4, *figures, strict=True))
        return cls(CycleError(before_m, before_deg), CycleError(after_m, after_deg), pairs)
