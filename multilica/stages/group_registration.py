# SPDX-License-Identifier: Apache-2.0
"""Registration of two groups of LiDARs during merging."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from multilica.acceptance.rig import is_contradicted
from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.registration.poses import arc_between_m, is_distinct, is_near
from multilica.results import Group, Hypothesis, PairKey, PairRegistration, Registration, Verdict

# A pose that slides moves farther when it is perturbed.
_STABLE_M = 0.05

RegisterGroups = Callable[[Group, Group, Sequence[Hypothesis], bool], PairRegistration]
"""Registers the second group against the first from hypotheses, with or without the fit to planes."""


def poses_between(
    group: Group, other: Group, verified: Mapping[PairKey, Sequence[Registration]]
) -> list[RigidTransform]:
    """Return the verified poses of all pairs with one LiDAR in each group."""
    return [
        each.T_target_source
        for pair, registrations in verified.items()
        if len({*pair} & {*group.poses}) == 1 and len({*pair} & {*other.poses}) == 1
        for each in registrations
    ]


def register_groups(
    group: Group,
    other: Group,
    pairs: Sequence[PairRegistration],
    verified: Sequence[RigidTransform],
    register: RegisterGroups,
    config: CalibrationConfig,
) -> PairRegistration | None:
    """Register two groups from all that is known of their members; if that is refused, from accepted pairs alone.

    Two groups have more poses that fit by chance than two LiDARs. A pose without an accepted
    pair does not overrule a pose with one, unless it has more evidence and is not rejected. A registration that starts
    from an accepted pair takes its information from that pair.

    Args:
        pairs: registrations between members, the one with the most evidence first.
        verified: further poses between members.

    Returns:
        None if no pose between members is known.
    """
    accepted = [pair.T_target_source for pair in pairs if pair.verdict.accepted]
    known = [*(pair.T_target_source for pair in pairs if not is_contradicted(pair)), *verified]
    max_baseline_m = config.acceptance.max_baseline_m

    def registered(poses: Sequence[RigidTransform]) -> PairRegistration | None:
        between_roots = (group.pose_of(other, pose) for pose in poses)
        near = [Hypothesis(pose) for pose in between_roots if is_near(pose, max_baseline_m)]
        return register(group, other, near, not accepted) if near else None

    found = registered(known)
    if found is None or found.verdict.accepted or not config.verify.enabled:
        return found
    again = registered(accepted)
    if again is None or _has_more_evidence(found, again, max_baseline_m):
        return found
    if not again.verdict.accepted and _is_constrained_by(again, [group.pose_of(other, pose) for pose in accepted]):
        again = replace(again, verdict=Verdict("accept"))
    return again if again.verdict.accepted else found


def _has_more_evidence(found: PairRegistration, again: PairRegistration, max_baseline_m: float) -> bool:
    """Return whether a registration that is not rejected has more evidence than another, at another possible pose."""
    pose = found.T_target_source
    elsewhere = is_distinct(pose, [again.T_target_source.with_target(pose.target)])
    possible = found.verdict.outcome == "undecided" and is_near(pose, max_baseline_m)
    return possible and elsewhere and found.evidence > again.evidence


def _is_constrained_by(found: PairRegistration, accepted: Sequence[RigidTransform]) -> bool:
    """Return whether an accepted pair constrains the registration, which by itself is refused as not constrained.

    More points hardly loosen a pose, but those of a group are thinned more than those of a pair.
    """
    if found.verdict.codes != ("not_observable",) or len(found.registrations) != 1:
        return False
    stability = found.registrations[0].stability
    if stability is None or stability.perturbed_offset_m > _STABLE_M:
        return False
    pose = found.T_target_source.with_target(accepted[0].target)
    return min(arc_between_m(pose, known) for known in accepted) <= _STABLE_M
