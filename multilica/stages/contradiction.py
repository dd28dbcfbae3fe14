# SPDX-License-Identifier: Apache-2.0
"""Accepted pairs that cannot both be right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

from multilica.config import VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import PairRegistration, Reason, Verdict
from multilica.stages.decide import max_violation_share
from multilica.stages.poses import is_distinct
from multilica.stages.witness import Trial
from multilica.testimony import Testimony

__all__ = ["doubt_by_contradiction"]


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
    return Reason("cycle_contradicted", share, limit, text)
