# SPDX-License-Identifier: Apache-2.0
"""How registered pairs became one rig."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["EdgeResidual", "MergeCandidate", "MergeDecision", "Refinement"]


@dataclass(frozen=True, slots=True)
class MergeCandidate:
    """A pair that a merge step could have chosen; `reason` says why it does not pass."""

    target: str
    source: str
    fitness: float
    rmse_m: float
    passes: bool
    evidence: float = 0.0
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class MergeDecision:
    """One turn of Algorithm 1.

    Args:
        step: from 0.
        candidates: what could have been chosen, best first.
        chosen: the pair that was merged; None when the algorithm stopped.
        reason: why, in one sentence with its figures.
        groups: members of every connected group after the step, largest first.
    """

    step: int
    candidates: tuple[MergeCandidate, ...]
    chosen: MergeCandidate | None
    reason: str
    groups: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class EdgeResidual:
    """By how much the poses of a rig disagree with one of its pairs, before and after the joint adjustment.

    Args:
        weight: what the pair counted for in the end, from 1 down to 0 for an outlier.
        snapshot: the snapshot that the pair is of; empty where there is only one.
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
    """What the joint adjustment did; without loops nothing is left to adjust."""

    edges: tuple[EdgeResidual, ...] = ()

    @property
    def cycle_error_m(self) -> tuple[float, float]:
        """Largest disagreement in metres before and after."""
        return (
            max((edge.before_m for edge in self.edges), default=0.0),
            max((edge.after_m for edge in self.edges), default=0.0),
        )

    @property
    def cycle_error_deg(self) -> tuple[float, float]:
        """Largest disagreement in degrees before and after."""
        return (
            max((edge.before_deg for edge in self.edges), default=0.0),
            max((edge.after_deg for edge in self.edges), default=0.0),
        )
