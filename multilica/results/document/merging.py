# SPDX-License-Identifier: Apache-2.0
"""Merge steps and the joint refinement in the result document."""

from pydantic import Field

from multilica.results.document.values import Entry, Number, PairNames

__all__ = ["CandidateEntry", "CycleErrorEntry", "DecisionEntry", "RefinementEntry", "ResidualEntry"]


class CandidateEntry(PairNames):
    """A pair that a merge step could have chosen."""

    fitness: Number = Field(description="Share of the source points that lie near a surface of the target cloud.")
    rmse_m: Number = Field(description="RMS distance of those points to their nearest target point.")
    passes: bool = Field(description="Whether the pair may be merged.")
    evidence: Number = Field(description="Evidence of the pair's registration.")
    reason: str = Field(description="Why the pair does not pass; empty if it does.")


class DecisionEntry(Entry):
    """One merge step."""

    step: int = Field(description="Number of the step, from 0.")
    candidates: tuple[CandidateEntry, ...] = Field(description="Pairs that could have been chosen, the best first.")
    chosen: CandidateEntry | None = Field(description="The pair that was merged; null if the merge stopped here.")
    reason: str = Field(description="Why, with its figures.")
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
