# SPDX-License-Identifier: Apache-2.0
"""Graph of accepted pairs: the groups of LiDARs that they link, and the poses that follow."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from multilica.geometry import RigidTransform
from multilica.results import PairRegistration


@dataclass(frozen=True, slots=True, eq=False)
class PairGraph:
    """LiDARs with the pairs that link them.

    Args:
        tree: of the given pairs, those of a spanning tree: the ones with the most evidence.
        loops: the others.
    """

    tree: tuple[PairRegistration, ...]
    loops: tuple[PairRegistration, ...]
    _groups: dict[str, dict[str, RigidTransform]] = field(default_factory=dict)

    @classmethod
    def of(cls, names: Iterable[str], pairs: Sequence[PairRegistration]) -> "PairGraph":
        """Link LiDARs by pairs, accepted ones first, and the ones with the most evidence first."""
        groups = {name: {name: RigidTransform.identity(name, name)} for name in names}
        tree: list[PairRegistration] = []
        loops: list[PairRegistration] = []
        for pair in sorted(pairs, key=_order):
            kept, added, pose = groups[pair.target], groups[pair.source], pair.T_target_source
            if kept is added:
                loops.append(pair)
                continue
            tree.append(pair)
            if min(added) < min(kept):
                kept, added, pose = added, kept, pose.inverse()
            T_root_added = kept[pose.target] @ pose @ added[pose.source].inverse()
            kept.update({name: T_root_added @ member for name, member in added.items()})
            groups |= dict.fromkeys(added, kept)
        return cls(tuple(tree), tuple(loops), groups)

    def poses(self, name: str) -> dict[str, RigidTransform]:
        """Return ``T_name_member`` of the members of a LiDAR's group, itself included."""
        group = self._groups[name]
        to_name = group[name].inverse()
        return {member: to_name @ pose for member, pose in group.items()}

    def implied(self, target: str, source: str) -> RigidTransform | None:
        """Return the pose of two LiDARs that follows; None if nothing links them."""
        group = self._groups[target]
        return group[target].inverse() @ group[source] if source in group else None

    def path(self, target: str, source: str) -> list[PairRegistration]:
        """Return the pairs of the tree between two LiDARs; empty if nothing links them."""
        paths: dict[str, list[PairRegistration]] = {target: []}
        for name in (reached := [target]):
            for pair in self.tree:
                beyond = pair.lidars - {name}
                if len(beyond) == 1 and not beyond <= paths.keys():
                    (further,) = beyond
                    paths[further] = [*paths[name], pair]
                    reached.append(further)
        return paths.get(source, [])

    def cycle(self, loop: PairRegistration) -> list[PairRegistration]:
        """Return one of the loops with the pairs of the tree between its ends."""
        return [loop, *self.path(loop.target, loop.source)]

    def entangled(self, cycle: Sequence[PairRegistration]) -> list[PairRegistration]:
        """Return the pairs of a cycle, and of all cycles that share pairs with it or with another of these."""
        found, others = list(cycle), [self.cycle(loop) for loop in self.loops]
        while joining := next((each for each in others if any(pair in found for pair in each)), None):
            others.remove(joining)
            found += (pair for pair in joining if pair not in found)
        return found

    def lidars_between(self, target: str, source: str) -> list[str]:
        """Return the names along that path, target and source included."""
        names = [target]
        for pair in self.path(target, source):
            names += pair.lidars - {names[-1]}
        return names


def _order(pair: PairRegistration) -> tuple[bool, float, str, str]:
    return not pair.verdict.accepted, -pair.evidence, pair.target, pair.source
