# SPDX-License-Identifier: Apache-2.0
"""Doubt from accepted pairs that contradict each other."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from multilica.acceptance.accept import accept, max_violation_share
from multilica.config import AcceptanceConfig, StabilityConfig
from multilica.geometry import RigidTransform
from multilica.registration.poses import is_distinct
from multilica.results import PairRegistration, Reason, Verdict, VisibilityScore
from multilica.visibility.sensor_view import ScorePose

__all__ = ["check_ambiguous_chains", "check_cycle_consistency", "is_contradicted"]

_CODE = "cycle_contradicted"


def check_cycle_consistency(
    pairs: Sequence[PairRegistration], score_pose: ScorePose, config: AcceptanceConfig
) -> list[PairRegistration]:
    """Leave accepted pairs undecided that put two LiDARs where their beams prove that they cannot both be.

    Two accepted pairs with one LiDAR in common imply a pose between the two others. If beams contradict it, one of the
    pairs is wrong: the one with less evidence is doubted, and so is the other unless it has clearly more.

    Returns:
        The pairs in their order, some with another verdict.
    """
    accepted = sorted(_accepted(pairs), key=lambda pair: -pair.evidence)
    doubts: dict[int, Reason] = {}
    for strong, weak in combinations(accepted, 2):
        implied = _implied(strong, weak)
        if implied is None or _is_known(implied, accepted):
            continue
        score = score_pose(implied).visibility
        limit = max_violation_share(score, config)
        if score.violation_share <= limit:
            continue
        contradicted = [strong, weak] if weak.evidence > config.max_competing_share * strong.evidence else [weak]
        for pair in contradicted:
            doubts.setdefault(id(pair), _contradiction(strong if pair is weak else weak, implied, score, limit))
    return _doubted(pairs, doubts)


def check_ambiguous_chains(
    pairs: Sequence[PairRegistration], score_pose: ScorePose, config: AcceptanceConfig, stability: StabilityConfig
) -> list[PairRegistration]:
    """Leave accepted pairs undecided that imply a pose which an undecided pair with more evidence excludes.

    A pair that can slide, or that a symmetric scene leaves ambiguous, has several poses; the correct one is among
    them, or scores as well. If a chain of accepted pairs implies another one, a pair of the chain fits by chance: the
    one that the fewest points constrain is doubted.

    Returns:
        The pairs in their order, some with another verdict.
    """
    accepted = _accepted(pairs)
    doubts: dict[int, Reason] = {}
    undecided = [pair for pair in pairs if _is_ambiguous(pair, config, stability)]
    for known in sorted(undecided, key=lambda pair: -pair.evidence):
        while chain := _chain(known.target, known.source, [pair for pair in accepted if id(pair) not in doubts]):
            implied = _composed(known.target, chain)
            by_chance = [pair for pair in chain if pair.evidence < known.evidence]
            if not by_chance or _allows(known, implied, score_pose, config):
                break
            loosest = min(by_chance, key=lambda pair: pair.registrations[0].visibility.min_information_eigenvalue)
            doubts[id(loosest)] = _exclusion(known, implied)
    return _doubted(pairs, doubts)


def is_contradicted(pair: PairRegistration) -> bool:
    """Tell whether the pair is doubted because it contradicts others."""
    return _CODE in pair.verdict.codes


def _accepted(pairs: Sequence[PairRegistration]) -> list[PairRegistration]:
    return [pair for pair in pairs if pair.verdict.accepted and pair.registrations]


def _doubted(pairs: Sequence[PairRegistration], doubts: Mapping[int, Reason]) -> list[PairRegistration]:
    return [
        replace(pair, verdict=Verdict("undecided", (doubts[id(pair)],))) if id(pair) in doubts else pair
        for pair in pairs
    ]


def _is_ambiguous(pair: PairRegistration, config: AcceptanceConfig, stability: StabilityConfig) -> bool:
    """Tell whether the pair, by itself, is refused only because other poses fit as well."""
    if not pair.registrations or pair.verdict.outcome != "undecided":
        return False
    verdict = accept(pair.registrations, config, stability)
    return verdict.outcome == "undecided" and {*verdict.codes} <= {"ambiguous", "not_observable"}


def _chain(start: str, end: str, pairs: Sequence[PairRegistration]) -> list[PairRegistration]:
    """Find the shortest chain of pairs from one LiDAR to another; empty if there is none."""
    chains: dict[str, list[PairRegistration]] = {start: []}
    for name in (reached := [start]):
        for pair in pairs:
            beyond = pair.lidars - {name}
            if len(beyond) == 1 and not beyond <= chains.keys():
                (further,) = beyond
                chains[further] = [*chains[name], pair]
                reached.append(further)
    return chains.get(end, [])


def _composed(start: str, chain: Sequence[PairRegistration]) -> RigidTransform:
    pose = RigidTransform.identity(start, start)
    for pair in chain:
        pose = pose @ pair.T_target_source.with_target(pose.source)
    return pose


def _allows(pair: PairRegistration, implied: RigidTransform, score_pose: ScorePose, config: AcceptanceConfig) -> bool:
    """Tell whether the implied pose is one of the pair's own, or scores as well."""
    needed = config.max_standing_share * pair.evidence
    own = [each.T_target_source for each in pair.registrations if each.evidence > needed]
    return not is_distinct(implied, own) or score_pose(implied).evidence > needed


def _exclusion(pair: PairRegistration, implied: RigidTransform) -> Reason:
    metres, radians = pair.T_target_source.distance_to(implied)
    text = (
        f"with other accepted pairs it puts {implied.source} {metres:.2f} m and {np.rad2deg(radians):.0f} deg from "
        f"where {implied.source} fits {implied.target} with more evidence; one of the pairs is wrong"
    )
    return Reason(_CODE, metres, 0.0, text)


def _implied(first: PairRegistration, second: PairRegistration) -> RigidTransform | None:
    """Return the pose between the LiDARs that two pairs do not share; None if they share none."""
    common = first.lidars & second.lidars
    if len(common) != 1:
        return None
    (hub,) = common
    outward = [pair.T_target_source.with_target(hub) for pair in (first, second)]
    return outward[0].inverse() @ outward[1]


def _is_known(implied: RigidTransform, accepted: Sequence[PairRegistration]) -> bool:
    """Tell whether an accepted pair closes the cycle."""
    for pair in accepted:
        if pair.lidars == {implied.target, implied.source}:
            return not is_distinct(implied, [pair.T_target_source.with_target(implied.target)])
    return False


def _contradiction(other: PairRegistration, implied: RigidTransform, score: VisibilityScore, limit: float) -> Reason:
    share = score.violation_share
    text = (
        f"together with {other.source} in {other.target} it puts {implied.source} where {share:.1%} of the points "
        f"shared with {implied.target} lie in proven-empty space (limit {limit:.1%}); one of the two is wrong"
    )
    return Reason(_CODE, share, limit, text)
