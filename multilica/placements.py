# SPDX-License-Identifier: Apache-2.0
"""What became of each LiDAR, and why."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from multilica.config import STAGES, Stage
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.results import LidarPlacement, MergeCandidate, MergeDecision, PairRegistration
from multilica.stages.prior import known_between

__all__ = ["Findings", "placement_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """What the stages found of a rig, as far as they went.

    Args:
        poses: ``T_target_lidar`` of the target's group.
        seeing: LiDARs that have returns left; empty before the stage that drops returns.
        until: the last stage that was asked for.
    """

    target: str
    poses: Mapping[str, RigidTransform]
    covariances: Mapping[str, FloatArray]
    pairs: Sequence[PairRegistration]
    decisions: Sequence[MergeDecision]
    seeing: Collection[str]
    until: Stage
    prior: Extrinsics | None


def placement_of(name: str, found: Findings) -> LidarPlacement:
    """The LiDAR's pose with its figures, or why it has none."""
    claimed = known_between(found.prior, found.target, name)
    if name == found.target:
        pose, fitness, rmse_m, reason = RigidTransform.identity(name, name), 1.0, 0.0, "the target"
    elif name in found.poses:
        link = _link_of(name, found.decisions)
        pose, fitness, rmse_m, reason = found.poses[name], link.fitness, link.rmse_m, "placed"
    else:
        return LidarPlacement(name, _why_not_placed(name, found), T_target_source_prior=claimed)
    return LidarPlacement(
        name,
        reason,
        placed=True,
        T_target_source=pose,
        fitness=fitness,
        rmse_m=rmse_m,
        covariance=found.covariances.get(name),
        T_target_source_prior=claimed,
    )


def _link_of(name: str, decisions: Sequence[MergeDecision]) -> MergeCandidate:
    """The pair whose merge brought the LiDAR into the target's group."""
    chosen = (decision.chosen for decision in decisions if name in decision.groups[0])
    return next(candidate for candidate in chosen if candidate is not None)


def _why_not_placed(name: str, found: Findings) -> str:
    if name not in found.seeing and found.seeing:
        return "no returns are left of it"
    if found.until in STAGES[: STAGES.index("merge")]:
        return f"stopped after stage {found.until} as asked"
    own = [pair for pair in found.pairs if name in (pair.target, pair.source)]
    if not own:
        return "no pose was found against any other LiDAR"
    best = max(own, key=lambda pair: pair.evidence)
    other = best.target if best.source == name else best.source
    why = "; ".join(reason.text for reason in best.verdict.reasons) or _last_refusal(name, found)
    return f"its best registration, with {other}: {why}"


def _last_refusal(name: str, found: Findings) -> str:
    """Why the group of a LiDAR that has an accepted pair was not joined to the target's."""
    last = found.decisions[-1]
    members = next((group for group in last.groups if name in group), (name,))
    reasons = [each.reason for each in last.candidates if {each.target, each.source} & {*members} and each.reason]
    return reasons[0] if reasons else f"{' and '.join(members)} could not be joined to {found.target}"
