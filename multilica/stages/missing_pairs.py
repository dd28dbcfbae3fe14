# SPDX-License-Identifier: Apache-2.0
"""Choice of the pairs that are searched or registered again."""

from collections.abc import Collection, Iterable, Mapping

from multilica.geometry import RigidTransform
from multilica.registration.poses import is_distinct
from multilica.results import Group, PairKey, PairRegistration, connected

__all__ = ["open_loops", "unconnected_pairs"]


def unconnected_pairs(
    pairs: Iterable[PairKey], registrations: Mapping[PairKey, PairRegistration], doubted: Collection[PairKey]
) -> tuple[PairKey, ...]:
    """Return the pairs that no chain of accepted pairs connects, and for which another search may help.

    Args:
        doubted: pairs that were accepted by themselves, and then contradicted by others. They are left out, and so
            are pairs that the scene does not constrain: there the search found the pose, and the scene refuses it.
    """
    accepted = [pair for pair in registrations.values() if pair.verdict.accepted]
    return tuple(
        (target, source)
        for target, source in pairs
        if source not in connected(target, accepted)
        and (target, source) not in doubted
        and not _is_unconstrained(registrations.get((target, source)))
    )


def _is_unconstrained(pair: PairRegistration | None) -> bool:
    return pair is not None and {"not_observable"} <= {*pair.verdict.codes} <= {"ambiguous", "not_observable"}


def open_loops(
    group: Group, pairs: Iterable[PairKey], registrations: Mapping[PairKey, PairRegistration]
) -> dict[PairKey, RigidTransform]:
    """Return the pairs of placed LiDARs without an accepted registration, with the pose that the rig implies.

    The search may have missed that pose. Pairs are left out whose registration ended there and was refused only
    because the scene does not constrain it.
    """
    placed = {
        pair: group.poses[pair[0]].inverse() @ group.poses[pair[1]] for pair in pairs if set(pair) <= set(group.poses)
    }
    return {pair: pose for pair, pose in placed.items() if _is_open(registrations.get(pair), pose)}


def _is_open(before: PairRegistration | None, implied: RigidTransform) -> bool:
    if before is None:
        return True
    ended_there = not is_distinct(implied, [before.T_target_source.with_target(implied.target)])
    return not before.verdict.accepted and not (ended_there and before.verdict.codes == ("not_observable",))
