# SPDX-License-Identifier: Apache-2.0
"""Pairs of LiDARs in the result document, from registration to refinement."""

from typing import Literal

import numpy as np
from pydantic import Field

from multilica.geometry import RigidTransform
from multilica.results.document.values import Entry, Matrix4, Matrix6, Number, PairNames, PoseEntry


class ReasonEntry(Entry):
    """Reason why a registration was not accepted, or a sensor not trusted."""

    code: str = Field(description="Stable name, for programs.")
    value: Number = Field(description="The measured figure.")
    limit: Number = Field(description="The limit that the figure exceeds or misses.")
    text: str = Field(description="The reason for people.")


class VerdictEntry(Entry):
    """Verdict on a registration, with its reasons."""

    outcome: Literal["accept", "uncertain", "undecided", "reject"] = Field(
        description="`uncertain` if only its standard deviation is above the limit."
    )
    reasons: tuple[ReasonEntry, ...] = Field(description="Reasons against it; empty if it is accepted.")

    @property
    def accepted(self) -> bool:
        """True if the registration may be merged."""
        return self.outcome == "accept"


class StabilityEntry(Entry):
    """Motion of the registered pose after perturbations; rotations count as arcs at 10 m."""

    sigma_m: Number = Field(description="Standard deviation of the position in its weakest direction.")
    sigma_rad: Number = Field(description="Standard deviation of the attitude in its weakest direction.")
    perturbation_m: Number = Field(description="Displacement of the pose along its weakest direction.")
    perturbed_offset_m: Number = Field(
        description="Distance from the pose to the end of the registration after the perturbation."
    )
    thinned_offset_m: Number = Field(
        description="Distance from the pose to the end of the registration of fewer points."
    )


class RegistrationEntry(Entry):
    """One hypothesis after GICP, with its visibility score."""

    hypothesis: int = Field(description="Index of its hypothesis; -1 if the pose came from other pairs.")
    origin: str = Field(description="Solver of that hypothesis, or `prior`; empty if the pose came from other pairs.")
    derivation: str = Field(
        "",
        description="Relation of the pose to its hypothesis, or the LiDARs that imply it; else empty.",
    )
    T_target_source: Matrix4 = Field(description="Rows of the homogeneous matrix, lengths.")
    agree: int = Field(description="Points on a surface that the other LiDAR measured.")
    violate: int = Field(description="Points in space that beams of the other LiDAR passed through.")
    occluded: int = Field(description="Points behind a measured surface.")
    unseen: int = Field(description="Points outside the field of view of the other LiDAR.")
    evidence: Number = Field(description="Log-odds that the pose is the true one; the rank.")
    fitness: Number = Field(description="Share of the points that lie near a surface of the target cloud.")
    rmse_m: Number = Field(description="RMS distance of those points to their nearest target point.")
    weakest_curvature: Number = Field(
        description="Smallest eigenvalue of the GICP Hessian per inlier; rotation at 10 m."
    )
    min_information_eigenvalue: Number = Field(description="Number of points that constrain the weakest direction.")
    stability: StabilityEntry | None = Field(description="Result of the stability test; null if it was not run.")


class PairEntry(PoseEntry, PairNames):
    """A registered pair of LiDARs."""

    fitness: Number = Field(description="Share of the source points that lie near a surface of the target cloud.")
    rmse_m: Number = Field(description="RMS distance of those points to their nearest target point.")
    inliers: int = Field(description="Number of those points.")
    converged: bool | None = Field(description="True if GICP converged; null if the engine does not report it.")
    iterations: int | None = Field(description="Number of GICP iterations; null where the engine does not report it.")
    engine: str = Field(description="GICP implementation.")
    hypothesis: int = Field(description="Index of its hypothesis; -1 if the pose came from other pairs.")
    hessian: Matrix6 | None = Field(description="GICP Hessian, order rotation, translation, about the source frame.")
    verdict: VerdictEntry = Field(description="The decision on this pair.")
    registrations: tuple[RegistrationEntry, ...] = Field(description="Chosen first; empty without verification.")

    @property
    def pose(self) -> RigidTransform:
        """``T_target_source`` of the pair."""
        return RigidTransform(self.target, self.source, np.asarray(self.T_target_source))

    @property
    def evidence(self) -> float:
        """Evidence of the chosen registration; the fitness without verification."""
        return (self.registrations[0].evidence if self.registrations else self.fitness) or 0.0


class CandidateEntry(PairNames):
    """A pair that a merge step could have chosen."""

    fitness: Number = Field(description="Share of the source points that lie near a surface of the target cloud.")
    rmse_m: Number = Field(description="RMS distance of those points to their nearest target point.")
    passes: bool = Field(description="True if the pair may be merged.")
    evidence: Number = Field(description="Evidence of the pair's registration.")
    reason: str = Field(description="Reason why the pair does not pass; empty if it does.")
    uncertain: bool = Field(description="True if the pair may be merged only where no other pair passes.")
    of_groups: bool = Field(
        default=False, description="True if the merged clouds of two groups were registered; the names are their roots."
    )


class DecisionEntry(Entry):
    """One merge step."""

    step: int = Field(description="Number of the step, from 0.")
    candidates: tuple[CandidateEntry, ...] = Field(description="Pairs that could have been chosen, the best first.")
    chosen: CandidateEntry | None = Field(description="The pair that was merged; null if the merge stopped here.")
    reason: str = Field(description="Reason for the decision, with its figures.")
    groups: tuple[tuple[str, ...], ...] = Field(description="Connected LiDARs after the step, the largest group first.")


class CycleErrorEntry(Entry):
    """Largest disagreement of the poses with a registered pair."""

    m: Number = Field(description="Distance.")
    deg: Number = Field(description="Angle.")


class ResidualEntry(PairNames):
    """Disagreement of the poses with one registered pair, before and after the refinement."""

    before_m: Number = Field(description="Distance before.")
    before_deg: Number = Field(description="Angle before.")
    after_m: Number = Field(description="Distance after.")
    after_deg: Number = Field(description="Angle after.")
    weight: float = Field(description="Final weight of the pair: 1 for full trust, 0 for an outlier.")
    snapshot: str = Field(description="Snapshot of the pair; empty for a single snapshot.")


class RefinementEntry(Entry):
    """The joint refinement over all accepted pairs."""

    cycle_error_before: CycleErrorEntry = Field(description="Largest disagreement before.")
    cycle_error_after: CycleErrorEntry = Field(description="Largest disagreement after.")
    pairs: tuple[ResidualEntry, ...] = Field(description="Disagreement per pair.")
