# SPDX-License-Identifier: Apache-2.0
"""Loops of the rig that the search left open."""

from collections.abc import Iterable, Mapping

from multilica.geometry import RigidTransform
from multilica.registration.poses import is_distinct
from multilica.results import Group, PairKey, PairRegistration

__all__ = ["open_loops"]


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
