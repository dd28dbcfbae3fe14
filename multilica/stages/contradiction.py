# SPDX-License-Identifier: Apache-2.0
"""Accepted pairs that cannot all be right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from multilica.config import VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import PairRegistration, Reason, Verdict
from multilica.stages.decide import decide, max_violation_share
from multilica.stages.poses import is_distinct
from multilica.stages.witness import Trial
from multilica.testimony import Testimony

__all__ = ["doubt_by_contradiction", "doubt_by_open_pairs", "is_contradicted"]

_CODE = "cycle_contradicted"


def doubt_by_contradiction(
    pairs: Sequence[PairRegistration], testify: Trial, config: VerifyConfig
) -> list[PairRegistration]:
    """Leave accepted pairs undecided that put two LiDARs where their beams prove that they cannot both be.

    Two accepted pairs with one LiDAR in common imply a pose between the two others. If beams contradict it, one of the
    pairs is wrong: the one with less evidence is doubted, and so is the other unless it has clearly more.

    Args:
        pairs: registrations with verdicts and assessments.
        testify: judges a pose between any two LiDARs.

    Returns:
        The pairs in their order, some with another verdict.
    """
    accepted = sorted(
        (pair for pair in pairs if pair.verdict.accepted and pair.assessments), key=lambda pair: -pair.evidence
    )
    doubts: dict[int, Reason] = {}
    for strong, weak in combinations(accepted, 2):
        implied = _implied(strong, weak)
        if implied is None or _is_known(implied, accepted):
            continue
        testimony = testify(implied)
        limit = max_violation_share(testimony, config)
        if testimony.violation_share <= limit:
            continue
        contradicted = [strong, weak] if weak.evidence > config.max_runner_up * strong.evidence else [weak]
        for pair in contradicted:
            doubts.setdefault(id(pair), _reason(strong if pair is weak else weak, implied, testimony, limit))
    return [
        replace(pair, verdict=Verdict("undecided", (doubts[id(pair)],))) if id(pair) in doubts else pair
        for pair in pairs
    ]


def doubt_by_open_pairs(
    pairs: Sequence[PairRegistration], testify: Trial, config: VerifyConfig
) -> list[PairRegistration]:
    """Leave accepted pairs undecided that lead to a pose which an undecided pair with more evidence knows nothing of.

    A pair that can slide, or that a scene alike from both ends leaves open, has several answers, and the true pose is
    one of them or looks as good. If a chain of accepted pairs implies another one, a pair of the chain fits by chance:
    the one whose pose the fewest points hold is doubted.

    Args:
        pairs: registrations with verdicts and assessments.
        testify: judges a pose between any two LiDARs.

    Returns:
        The pairs in their order, some with another verdict.
    """
    accepted = [pair for pair in pairs if pair.verdict.accepted and pair.assessments]
    doubts: dict[int, Reason] = {}
    for known in sorted((pair for pair in pairs if _is_open(pair, config)), key=lambda pair: -pair.evidence):
        while chain := _chain(known.target, known.source, [pair for pair in accepted if id(pair) not in doubts]):
            implied = _composed(known.target, chain)
            by_chance = [pair for pair in chain if pair.evidence < known.evidence]
            if not by_chance or _has_answer(known, implied, testify, config):
                break
            loosest = min(by_chance, key=lambda pair: pair.assessments[0].testimony.held_by)
            doubts[id(loosest)] = _unknown_to(known, implied)
    return [
        replace(pair, verdict=Verdict("undecided", (doubts[id(pair)],))) if id(pair) in doubts else pair
        for pair in pairs
    ]


def is_contradicted(pair: PairRegistration) -> bool:
    """Whether it is doubted because it does not go together with others."""
    return any(reason.code == _CODE for reason in pair.verdict.reasons)


def _is_open(pair: PairRegistration, config: VerifyConfig) -> bool:
    """Whether nothing speaks against its answers but that there are several; by itself, not because others doubt it."""
    if not pair.assessments or pair.verdict.outcome != "undecided":
        return False
    verdict = decide(pair.assessments, config)
    codes = {reason.code for reason in verdict.reasons}
    return verdict.outcome == "undecided" and codes <= {"ambiguous", "not_observable"}


def _chain(start: str, end: str, edges: Sequence[PairRegistration]) -> list[PairRegistration]:
    """The shortest way from one LiDAR to another; empty if there is none."""
    ways: dict[str, list[PairRegistration]] = {start: []}
    for name in (reached := [start]):
        for edge in edges:
            beyond = {edge.target, edge.source} - {name}
            if len(beyond) == 1 and not beyond <= ways.keys():
                (further,) = beyond
                ways[further] = [*ways[name], edge]
                reached.append(further)
    return ways.get(end, [])


def _composed(start: str, chain: Sequence[PairRegistration]) -> RigidTransform:
    pose = RigidTransform.identity(start, start)
    for edge in chain:
        step = edge.T_target_source
        pose = pose @ (step if step.target == pose.source else step.inverse())
    return pose


def _has_answer(pair: PairRegistration, implied: RigidTransform, testify: Trial, config: VerifyConfig) -> bool:
    needed = config.max_equal * pair.evidence
    answers = [each.T_target_source for each in pair.assessments if each.evidence > needed]
    return not is_distinct(implied, answers) or testify(implied).evidence > needed


def _unknown_to(pair: PairRegistration, implied: RigidTransform) -> Reason:
    metres, radians = pair.T_target_source.distance_to(implied)
    text = (
        f"with other accepted pairs it puts {implied.source} {metres:.2f} m and {np.rad2deg(radians):.0f} deg from "
        f"where it fits {implied.target}, which has more evidence: one of the pairs is wrong"
    )
    return Reason(_CODE, metres, 0.0, text)


def _implied(first: PairRegistration, second: PairRegistration) -> RigidTransform | None:
    """The pose between the LiDARs that are not in common; None if none is."""
    common = {first.target, first.source} & {second.target, second.source}
    if len(common) != 1:
        return None
    (hub,) = common
    outward = [
        pair.T_target_source if pair.target == hub else pair.T_target_source.inverse() for pair in (first, second)
    ]
    return outward[0].inverse() @ outward[1]


def _is_known(implied: RigidTransform, accepted: Sequence[PairRegistration]) -> bool:
    """Whether an accepted pair closes the cycle."""
    for pair in accepted:
        if {pair.target, pair.source} == {implied.target, implied.source}:
            pose = pair.T_target_source if pair.target == implied.target else pair.T_target_source.inverse()
            return not is_distinct(implied, [pose])
    return False


def _reason(other: PairRegistration, implied: RigidTransform, testimony: Testimony, limit: float) -> Reason:
    share = testimony.violation_share
    text = (
        f"together with {other.source} in {other.target}, it puts {implied.source} where {share:.1%} of the points "
        f"that it shares with {implied.target} stand in proven-empty space; expected {limit:.1%}: one of both is wrong"
    )
    return Reason(_CODE, share, limit, text)
