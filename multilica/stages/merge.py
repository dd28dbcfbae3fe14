# SPDX-License-Identifier: Apache-2.0
"""Merging of registered pairs into one rig: along the graph of accepted pairs, or by the paper's Algorithm 1."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from multilica.config import MergeConfig
from multilica.geometry import RigidTransform
from multilica.results import Group, MergeCandidate, MergeDecision, PairRegistration

__all__ = ["MergeStep", "merge", "merge_along_graph"]


Reregister = Callable[[Group, Group, Sequence[PairRegistration]], PairRegistration | None]
"""Registers the second group against the first, given the registrations between members; None if impossible."""


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
    target: str, names: Sequence[str], pairs: Sequence[PairRegistration], register_groups: Reregister
) -> Iterator[MergeStep]:
    """Join what accepted pairs link, the pair with the most evidence first; register groups only where none does.

    A pair that is accepted but uncertain joins what nothing else can join.

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
        ordered = sorted(
            {id(group): group for group in groups.values()}.values(),
            key=lambda group: (target not in group.poses, -len(group.poses), group.members),
        )
        decision = MergeDecision(
            step=step,
            candidates=tuple(_candidate(pair) for pair in ranked),
            chosen=None if chosen is None else _candidate(chosen),
            reason=_reason(ranked, chosen),
            groups=tuple(group.members for group in ordered),
        )
        yield MergeStep(decision, chosen, tuple(ordered))
        if chosen is None:
            return


def _by_evidence(pairs: Sequence[PairRegistration]) -> list[PairRegistration]:
    return sorted(pairs, key=lambda pair: (-pair.evidence, pair.target, pair.source))


def merge(
    target: str, names: Sequence[str], pairs: Sequence[PairRegistration], reregister: Reregister, config: MergeConfig
) -> Iterator[MergeStep]:
    """Run the paper's Algorithm 1: merge the best pair, register the rest against the grown cloud, repeat.

    Groups without the target grow as well, so a chain A-B, B-C, C-target ends with all placed, in whatever order its
    pairs are merged. Mode `target_first` is the paper's simpler one: every LiDAR accepted against the target is
    merged as it is, and only the rest is registered against the merged cloud.

    Args:
        names: all LiDARs, the target included.
        pairs: at most one registration per unordered pair.

    Yields:
        One step per turn; the last one has `chosen` None unless all LiDARs are placed.
    """
    state = _State(target, {name: Group.of_one(name) for name in names}, {pair.lidars: pair for pair in pairs})
    for step in range(len(names)):
        if len(state.groups) == 1:
            return
        target_first = config.mode == "target_first" and state.has_direct()
        ranked = state.ranked(direct_only=target_first)
        chosen = next((pair for pair in ranked if pair.verdict.accepted), None)
        if chosen is not None:
            state = state.merged(chosen, reregister, keep_pairs=target_first)
        groups = state.ordered_groups()
        decision = MergeDecision(
            step=step,
            candidates=tuple(_candidate(pair) for pair in ranked),
            chosen=None if chosen is None else _candidate(chosen),
            reason=_reason(ranked, chosen),
            groups=tuple(group.members for group in groups),
        )
        yield MergeStep(decision, chosen, groups)
        if chosen is None:
            return


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    target: str
    groups: Mapping[str, Group]
    pairs: Mapping[frozenset[str], PairRegistration]

    def has_direct(self) -> bool:
        return any(self.target in key and pair.verdict.accepted for key, pair in self.pairs.items())

    def ranked(self, *, direct_only: bool) -> list[PairRegistration]:
        pairs = [pair for key, pair in self.pairs.items() if not direct_only or self.target in key]
        return _by_evidence(pairs)

    def ordered_groups(self) -> tuple[Group, ...]:
        return tuple(
            sorted(self.groups.values(), key=lambda group: (group.root != self.target, -len(group.poses), group.root))
        )

    def merged(self, pair: PairRegistration, reregister: Reregister, *, keep_pairs: bool) -> _State:
        kept, added, T_kept_added = self._oriented(pair)
        grown = kept.joined(added, T_kept_added)
        groups = {root: group for root, group in self.groups.items() if root not in (kept.root, added.root)}
        pairs = {
            key: other
            for key, other in self.pairs.items()
            if added.root not in key and (keep_pairs or kept.root not in key)
        }
        after = _State(self.target, {**groups, grown.root: grown}, pairs)
        if keep_pairs and after.has_direct():
            return after
        return after.reregistered(grown, self.pairs, reregister)

    def reregistered(
        self, grown: Group, known: Mapping[frozenset[str], PairRegistration], reregister: Reregister
    ) -> _State:
        others = [group for root, group in sorted(self.groups.items()) if root != grown.root]
        fresh = {}
        for other in others:
            between = [pair for key, pair in known.items() if other.root in key and key & set(grown.poses)]
            if between:
                pair = reregister(grown, other, sorted(between, key=lambda pair: -pair.evidence))
                if pair is not None:
                    fresh[pair.lidars] = pair
        return _State(self.target, self.groups, {**self.pairs, **fresh})

    def _oriented(self, pair: PairRegistration) -> tuple[Group, Group, RigidTransform]:
        """Return the group that keeps its root, the target's or else the larger, the other group, and the pose."""
        first, second = self.groups[pair.target], self.groups[pair.source]
        swap = second.root == self.target or (first.root != self.target and len(second.poses) > len(first.poses))
        return (second, first, pair.T_target_source.inverse()) if swap else (first, second, pair.T_target_source)


def _candidate(pair: PairRegistration) -> MergeCandidate:
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
    )


def _reason(ranked: Sequence[PairRegistration], chosen: PairRegistration | None) -> str:
    if chosen is not None:
        accepted = sum(pair.verdict.accepted for pair in ranked)
        rank = "the only accepted pair" if accepted == 1 else f"ranked first of {accepted} accepted pairs"
        rank = rank if chosen.verdict.accepted else f"uncertain, and no accepted pair is left: {chosen.verdict.text}"
        return f"merged {chosen.source} into {chosen.target}: fitness {chosen.fitness:.3f}, {rank}"
    if not ranked:
        return "stopped: no pair is left that could be registered"
    best = ranked[0]
    pair = f"{best.source} in {best.target}"
    if len(ranked) == 1:
        return f"stopped: the only pair left, {pair}, is not accepted: {best.verdict.text}"
    return f"stopped: none of {len(ranked)} pairs is accepted; the best, {pair}: {best.verdict.text}"
