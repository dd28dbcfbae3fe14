# SPDX-License-Identifier: Apache-2.0
"""Grow one calibrated cloud out of registered pairs."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from multilica.config import MergeConfig
from multilica.geometry import RigidTransform
from multilica.results import MergeCandidate, MergeDecision, PairRegistration

__all__ = ["Group", "MergeStep", "merge", "pose_between"]


@dataclass(frozen=True, slots=True, eq=False)
class Group:
    """LiDARs whose poses relative to each other are known.

    Args:
        root: the member whose frame is the group's.
        poses: per member ``T_root_member``, the root with the identity.
    """

    root: str
    poses: Mapping[str, RigidTransform]

    @classmethod
    def of_one(cls, name: str) -> Group:
        """A LiDAR by itself."""
        return cls(name, {name: RigidTransform.identity(name, name)})

    @property
    def members(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(sorted(self.poses))

    def joined(self, other: Group, T_root_other: RigidTransform) -> Group:
        """This group with another one's members added."""
        added = {name: T_root_other @ pose for name, pose in other.poses.items()}
        return Group(self.root, {**self.poses, **added})


@dataclass(frozen=True, slots=True, eq=False)
class MergeStep:
    """A decision, the registration behind it, and the groups that it left, the target's first."""

    decision: MergeDecision
    chosen: PairRegistration | None
    groups: tuple[Group, ...]

    @property
    def grown(self) -> Group:
        """The group that the decision made larger; the target's if it made none."""
        chosen = self.decision.chosen
        return self.groups[0] if chosen is None else next(each for each in self.groups if chosen.target in each.poses)


def pose_between(group: Group, other: Group, known: RigidTransform) -> RigidTransform:
    """Where a known pose between two of their members, either way, puts the other group's root in this one's."""
    if known.target in other.poses:
        known = known.inverse()
    return group.poses[known.target] @ known @ other.poses[known.source].inverse()


Reregister = Callable[[Group, Group, Sequence[PairRegistration]], PairRegistration | None]
"""Registers the second group against the first, from what is known of their members' pairs; None if nothing is."""


def merge(
    target: str,
    names: Sequence[str],
    pairs: Sequence[PairRegistration],
    reregister: Reregister,
    config: MergeConfig,
) -> Iterator[MergeStep]:
    """The paper's Algorithm 1: merge the best pair, register the rest against the grown cloud, repeat.

    Groups that do not hold the target grow as well, so a chain A-B, B-C, C-target ends with all placed in whatever
    order its links are found. Mode `target_first` is the paper's simpler one: every LiDAR that passes against the
    target is merged as it is, only the rest is registered against the merged cloud.

    Args:
        target: root of the result.
        names: all LiDARs, the target included.
        pairs: at most one registration per unordered pair.
        reregister: see `Reregister`.

    Yields:
        One step per turn; the last one has `chosen` None unless all LiDARs are placed.
    """
    state = _State(target, {name: Group.of_one(name) for name in names}, {_key(pair): pair for pair in pairs})
    for step in range(len(names)):
        if len(state.groups) == 1:
            return
        ranked = state.ranked(direct_only=config.mode == "target_first" and state.has_direct())
        chosen = next((pair for pair in ranked if pair.verdict.accepted), None)
        if chosen is not None:
            state = state.merged(chosen, reregister, keep_links=config.mode == "target_first" and state.has_direct())
        yield MergeStep(_decide(step, ranked, chosen, state), chosen, state.ordered_groups())
        if chosen is None:
            return


def _key(pair: PairRegistration) -> frozenset[str]:
    return frozenset((pair.target, pair.source))


@dataclass(frozen=True, slots=True, eq=False)
class _State:
    target: str
    groups: Mapping[str, Group]
    links: Mapping[frozenset[str], PairRegistration]

    def has_direct(self) -> bool:
        return any(self.target in key and link.verdict.accepted for key, link in self.links.items())

    def ranked(self, *, direct_only: bool) -> list[PairRegistration]:
        links = [link for key, link in self.links.items() if not direct_only or self.target in key]
        return sorted(links, key=lambda link: (-link.evidence, link.target, link.source))

    def ordered_groups(self) -> tuple[Group, ...]:
        return tuple(
            sorted(self.groups.values(), key=lambda group: (group.root != self.target, -len(group.poses), group.root))
        )

    def merged(self, link: PairRegistration, reregister: Reregister, *, keep_links: bool) -> _State:
        kept, added, T_kept_added = self._oriented(link)
        grown = kept.joined(added, T_kept_added)
        groups = {root: group for root, group in self.groups.items() if root not in (kept.root, added.root)}
        links = {
            key: other
            for key, other in self.links.items()
            if added.root not in key and (keep_links or kept.root not in key)
        }
        after = _State(self.target, {**groups, grown.root: grown}, links)
        if keep_links and after.has_direct():
            return after
        return after.relinked(grown, self.links, reregister)

    def relinked(
        self, grown: Group, known: Mapping[frozenset[str], PairRegistration], reregister: Reregister
    ) -> _State:
        others = [group for root, group in sorted(self.groups.items()) if root != grown.root]
        fresh = {}
        for other in others:
            hints = [link for key, link in known.items() if other.root in key and key & set(grown.poses)]
            if hints:
                link = reregister(grown, other, sorted(hints, key=lambda hint: -hint.evidence))
                if link is not None:
                    fresh[_key(link)] = link
        return _State(self.target, self.groups, {**self.links, **fresh})

    def _oriented(self, link: PairRegistration) -> tuple[Group, Group, RigidTransform]:
        """The group that stays root first: the target's, else the larger one."""
        first, second = self.groups[link.target], self.groups[link.source]
        swap = second.root == self.target or (first.root != self.target and len(second.poses) > len(first.poses))
        return (second, first, link.T_target_source.inverse()) if swap else (first, second, link.T_target_source)


def _decide(
    step: int, ranked: Sequence[PairRegistration], chosen: PairRegistration | None, after: _State
) -> MergeDecision:
    return MergeDecision(
        step=step,
        candidates=tuple(_candidate(pair) for pair in ranked),
        chosen=None if chosen is None else _candidate(chosen),
        reason=_reason(ranked, chosen),
        groups=tuple(group.members for group in after.ordered_groups()),
    )


def _candidate(pair: PairRegistration) -> MergeCandidate:
    why = "; ".join(reason.text for reason in pair.verdict.reasons)
    return MergeCandidate(
        pair.target, pair.source, pair.fitness, pair.rmse_m, pair.verdict.accepted, evidence=pair.evidence, reason=why
    )


def _reason(ranked: Sequence[PairRegistration], chosen: PairRegistration | None) -> str:
    if chosen is not None:
        return (
            f"merged {chosen.source} into {chosen.target}: fitness {chosen.fitness:.3f}, the best accepted of "
            f"{len(ranked)} candidates"
        )
    if not ranked:
        return "stopped: no pair is left that could be registered"
    best = _candidate(ranked[0])
    pair = f"{best.source} in {best.target}"
    if len(ranked) == 1:
        return f"stopped: the only candidate, {pair}, is not accepted: {best.reason}"
    return f"stopped: none of {len(ranked)} candidates is accepted; the best, {pair}: {best.reason}"
