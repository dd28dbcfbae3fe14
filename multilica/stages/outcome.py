# SPDX-License-Identifier: Apache-2.0
"""Placement of each LiDAR, or the reason why it has none."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from multilica.config import STAGES, Stage
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.poses import is_distinct
from multilica.results import ContestedPlace, LidarPlacement, MergeCandidate, MergeDecision, PairRegistration
from multilica.visibility.sensor_view import ScorePose

__all__ = ["Findings", "contested_place", "placement_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """Results of the stages so far.

    Args:
        poses: ``T_target_lidar`` of the target's group.
        with_returns: LiDARs that have points after preprocessing; empty before that stage.
        until: the last stage of the run.
        score_pose: scores a pose between any two LiDARs; None where verification is off.
    """

    target: str
    poses: Mapping[str, RigidTransform]
    covariances: Mapping[str, FloatArray]
    pairs: Sequence[PairRegistration]
    decisions: Sequence[MergeDecision]
    with_returns: Collection[str]
    until: Stage
    prior: Extrinsics | None
    score_pose: ScorePose | None


def placement_of(name: str, found: Findings) -> LidarPlacement:
    """Return the LiDAR's pose with its figures, or why it has none."""
    prior = found.prior
    claimed = prior.between(found.target, name) if prior and {found.target, name} <= prior.members else None
    if name == found.target:
        pose, fitness, rmse_m, reason = RigidTransform.identity(name, name), 1.0, 0.0, "the target"
    elif name in found.poses:
        merged = _merged_by(name, found.decisions)
        pose, fitness, rmse_m, reason = found.poses[name], merged.fitness, merged.rmse_m, "placed"
    else:
        contested = contested_place(name, found.poses, found.pairs, found.score_pose)
        return LidarPlacement(name, _reason(name, found), T_target_source_prior=claimed, contested=contested)
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


def contested_place(
    lidar: str,
    poses: Mapping[str, RigidTransform],
    pairs: Sequence[PairRegistration],
    score_pose: ScorePose | None = None,
) -> ContestedPlace | None:
    """Find the two accepted pairs that put a LiDAR at the places farthest from each other, to the millimetre.

    Args:
        lidar: one that is not placed.
        poses: ``T_target_lidar`` of the placed LiDARs.
        score_pose: scores the pose of the first pair that follows from the other; None leaves that out.

    Returns:
        None where all accepted pairs with a placed LiDAR agree.
    """
    places = [
        (pair, poses[fixed] @ pair.T_target_source.with_target(fixed))
        for pair in sorted(pairs, key=lambda pair: -pair.evidence)
        if pair.verdict.accepted and lidar in pair.lidars
        for fixed in pair.lidars - {lidar}
        if fixed in poses
    ]
    apart = [
        (*here.distance_to(there), pair, other, there)
        for (pair, here), (other, there) in combinations(places, 2)
        if is_distinct(here, [there])
    ]
    if not apart:
        return None
    distance_m, angle_rad, pair, other, place = max(apart, key=lambda each: (round(each[0], 3), round(each[1], 3)))
    competing = None
    if score_pose is not None:
        (fixed,) = pair.lidars - {lidar}
        competing = score_pose((poses[fixed].inverse() @ place).with_target(pair.target))
    return ContestedPlace((pair.target, pair.source), (other.target, other.source), distance_m, angle_rad, competing)


def _merged_by(name: str, decisions: Sequence[MergeDecision]) -> MergeCandidate:
    """Return the pair whose merge brought the LiDAR into the target's group."""
    chosen = (decision.chosen for decision in decisions if name in decision.groups[0])
    return next(candidate for candidate in chosen if candidate is not None)


def _reason(name: str, found: Findings) -> str:
    if name not in found.with_returns and found.with_returns:
        return "it has no returns in range"
    if found.until in STAGES[: STAGES.index("merge")]:
        return f"the run stopped after stage {found.until} (--until)"
    own = [pair for pair in found.pairs if name in pair.lidars]
    if not own:
        return "no pose was found against any other LiDAR"
    best = max(own, key=lambda pair: pair.evidence)
    (other,) = best.lidars - {name}
    why = best.verdict.text or _last_refusal(name, found)
    return f"its best registration, with {other}: {why}"


def _last_refusal(name: str, found: Findings) -> str:
    """Return why the group of a LiDAR with an accepted pair was not merged into the target's."""
    last = found.decisions[-1]
    members = next((group for group in last.groups if name in group), (name,))
    reasons = [each.reason for each in last.candidates if {each.target, each.source} & {*members} and each.reason]
    return reasons[0] if reasons else f"{' and '.join(members)} could not be joined to {found.target}"
