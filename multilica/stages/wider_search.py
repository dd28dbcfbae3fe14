# SPDX-License-Identifier: Apache-2.0
"""Choice of the pairs that are searched again with descriptors of another size."""

from collections.abc import Collection, Iterable, Mapping

from multilica.results import PairKey, PairRegistration, connected

__all__ = ["unconnected_pairs"]


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
