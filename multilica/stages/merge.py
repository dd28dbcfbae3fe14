# SPDX-License-Identifier: Apache-2.0
"""Merging of registered pairs into one rig, along the graph of accepted pairs or as the paper does."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

from multilica.acceptance.rig import is_contradicted
from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.registration.poses import arc_between_m, is_distinct, is_near
from multilica.results import (
    Group,
    Hypothesis,
    MergeCandidate,
    MergeDecision,
    PairKey,
    PairRegistration,
    Registration,
    Verdict,
)

RegisterGroups = Callable[[Group, Group, Sequence[PairRegistration]], PairRegistration | None]
"""Registers the second group against the first, given the registrations between members; None if impossible."""
RegisterAgain = Callable[[Group, Group, PairRegistration], PairRegistration | None]
"""Registers the second group against the first from where the registration of their roots began."""
RegisterRest = Callable[[Group, Group], PairRegistration | None]
"""Registers the second group against the first from what is found between their clouds."""

# A pose that slides moves farther when it is perturbed.
_STABLE_M = 0.05

RegisterFrom = Callable[[Group, Group, Sequence[Hypothesis], bool], PairRegistration]
"""Registers the second group against the first from hypotheses, with or without the fit to planes."""


@dataclass(frozen=True, slots=True, eq=False)
class MergeStep:
    """A decision with its registration and the groups after it, the target's first."""

    decision: MergeDecision
    chosen: PairRegistration | None
    groups: tuple[Group, ...]

    @property
    def grown(self) -> Group:
        """The group that the decision enlarged; the target's if it enlarged none."""
        chosen = self.decision.chosen
        return self.groups[0] if chosen is None else next(each for each in self.groups if chosen.target in each.poses)


def merge_along_graph(
    target: str, names: Sequence[str], pairs: Sequence[PairRegistration], register_groups: RegisterGroups
) -> Iterator[MergeStep]:
    """Join what accepted pairs link, the pair with the most evidence first; register groups only where none does.

    A pair that is accepted but uncertain is used only if nothing else joins its LiDARs.

    Args:
        names: all LiDARs, the target included.
        pairs: at most one registration per unordered pair.

    Yields:
        One step per turn; the last one has `chosen` None unless all LiDARs are placed.
    """
    groups = {name: Group.of_one(name) for name in names}
    registered: dict[tuple[tuple[str, ...], ...], PairRegistration | None] = {}
    for step in range(len(names)):
        distinct = sorted({id(group): group for group in groups.values()}.values(), key=lambda group: group.members)
        if len(distinct) == 1:
            return
        ranked = _by_evidence([pair for pair in pairs if groups[pair.target] is not groups[pair.source]])
        chosen = next((pair for pair in ranked if pair.verdict.accepted), None)
        if chosen is None:
            for group, other in combinations(distinct, 2):
                between = [pair for pair in ranked if pair.lidars & {*group.poses} and pair.lidars & {*other.poses}]
                key = group.members, other.members
                if between and max(len(group.poses), len(other.poses)) > 1 and key not in registered:
                    registered[key] = register_groups(group, other, between)
            present = {group.members for group in distinct}
            of_groups = [found for key, found in registered.items() if found is not None and {*key} <= present]
            ranked = _by_evidence([*of_groups, *ranked])
            usable = (pair for outcome in ("accept", "uncertain") for pair in ranked if pair.verdict.outcome == outcome)
            chosen = next(usable, None)
        if chosen is not None:
            kept, added = groups[chosen.target], groups[chosen.source]
            if target in added.poses or (target not in kept.poses and len(added.poses) > len(kept.poses)):
                kept, added = added, kept
            grown = kept.joined(added, kept.pose_of(added, chosen.T_target_source))
            groups |= dict.fromkeys(grown.poses, grown)
        distinct_after = {id(group): group for group in groups.values()}.values()
        yield _step(step, ranked, chosen, target, distinct_after, pairs)
        if chosen is None:
            return


def _by_evidence(pairs: Sequence[PairRegistration]) -> list[PairRegistration]:
    return sorted(pairs, key=lambda pair: (-pair.evidence, pair.target, pair.source))


def merge_by_fitness(
    target: str, names: Sequence[str], pairs: Sequence[PairRegistration], register_again: RegisterAgain
) -> Iterator[MergeStep]:
    """Run the paper's Algorithm 1: merge the best pair, drop its source's other pairs, register its target's again.

    The paper's code ends without a result when a pair without the target LiDAR is the best, because it never counts
    that source as placed. Here the members of a group are placed when the group is joined to the target's.

    The steps are as those of `merge_along_graph`.

    Args:
        pairs: one or both directions of each pair; the target LiDAR is never a source.
    """
    groups = {name: Group.of_one(name) for name in names}
    candidates = {(pair.target, pair.source): pair for pair in pairs}
    for step in range(len(names)):
        if len(groups) == 1:
            return
        ranked = _by_evidence(list(candidates.values()))
        chosen = next((pair for pair in ranked if pair.verdict.accepted), None)
        if chosen is not None:
            kept, added, pose = groups[chosen.target], groups[chosen.source], chosen.T_target_source
            if added.root == target:
                kept, added, pose = added, kept, pose.inverse()
            del groups[added.root]
            groups[kept.root] = kept.joined(added, pose)
            candidates = {key: pair for key, pair in candidates.items() if added.root not in key}
            again = {
                key: register_again(groups[key[0]], groups[key[1]], pair)
                for key, pair in candidates.items()
                if kept.root in key
            }
            candidates = {key: pair for key, pair in {**candidates, **again}.items() if pair is not None}
        yield _step(step, ranked, chosen, target, groups.values(), pairs)
        if chosen is None:
            return


def merge_target_first(
    target: str, names: Sequence[str], pairs: Sequence[PairRegistration], register_rest: RegisterRest
) -> Iterator[MergeStep]:
    """Merge each LiDAR that is accepted against the target as it is, then register the rest to the merged cloud, once.

    This is the default of the paper's published code. That gives the pose of a LiDAR that fails twice, with a note that
    it is not successful; here that LiDAR is not placed. Pairs without the target are not used, and the steps are as
    those of `merge_along_graph`.
    """
    groups = {name: Group.of_one(name) for name in names}
    left = _by_evidence([pair for pair in pairs if target in pair.lidars])
    again = False
    for step in range(len(names)):
        if len(groups) == 1:
            return
        chosen = next((pair for pair in left if pair.verdict.accepted), None)
        if chosen is None and len(groups[target].poses) > 1 and not again:
            others = [group for root, group in sorted(groups.items()) if root != target]
            found = [register_rest(groups[target], other) for other in others]
            left, again = _by_evidence([pair for pair in found if pair is not None]), True
            chosen = next((pair for pair in left if pair.verdict.accepted), None)
        if chosen is not None:
            pose = chosen.T_target_source.with_target(target)
            groups[target] = groups[target].joined(groups.pop(pose.source), pose)
        yield _step(step, left, chosen, target, groups.values(), pairs)
        left = [pair for pair in left if pair is not chosen]
        if chosen is None:
            return


def _step(
    step: int,
    ranked: Sequence[PairRegistration],
    chosen: PairRegistration | None,
    target: str,
    groups: Iterable[Group],
    pairs: Sequence[PairRegistration],
) -> MergeStep:
    """Describe a step; what is not one of the given pairs is a registration of groups."""
    of_pairs = {id(pair) for pair in pairs}
    candidates = {id(pair): _candidate(pair, of_groups=id(pair) not in of_pairs) for pair in ranked}
    ordered = tuple(sorted(groups, key=lambda group: (target not in group.poses, -len(group.poses), group.members)))
    decision = MergeDecision(
        step=step,
        candidates=tuple(candidates.values()),
        chosen=None if chosen is None else candidates[id(chosen)],
        reason=_reason(ranked, chosen),
        groups=tuple(group.members for group in ordered),
    )
    return MergeStep(decision, chosen, ordered)


def _candidate(pair: PairRegistration, *, of_groups: bool) -> MergeCandidate:
    verdict = pair.verdict
    return MergeCandidate(
        pair.target,
        pair.source,
        pair.fitness,
        pair.rmse_m,
        verdict.accepted,
        pair.evidence,
        verdict.text,
        uncertain=verdict.outcome == "uncertain",
        of_groups=of_groups,
    )


def _reason(ranked: Sequence[PairRegistration], chosen: PairRegistration | None) -> str:
    if chosen is not None:
        accepted = sum(pair.verdict.accepted for pair in ranked)
        if not chosen.verdict.accepted:
            rank = f"uncertain, and no accepted pair is left: {chosen.verdict.text}"
        elif accepted == 1:
            rank = "the only accepted pair"
        else:
            rank = f"the highest of {accepted} accepted pairs"
        return f"merged {chosen.source} into {chosen.target}: {_rank_figure(chosen)}, {rank}"
    if not ranked:
        return "stopped: no pair is left that could be registered"
    best = ranked[0]
    pair = f"{best.source} in {best.target}"
    if len(ranked) == 1:
        return f"stopped: the only pair left, {pair}, is not accepted: {best.verdict.text}"
    return f"stopped: none of {len(ranked)} pairs is accepted; the best, {pair}: {best.verdict.text}"


def _rank_figure(pair: PairRegistration) -> str:
    """Return the figure that ranks the pair."""
    return f"evidence {pair.evidence:z.1f}" if pair.registrations else f"fitness {pair.fitness:.3f}"


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
    register: RegisterFrom,
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
