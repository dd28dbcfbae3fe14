# SPDX-License-Identifier: Apache-2.0
"""LiDARs that were not placed."""

from typing import NamedTuple

from multilica.config import Stage
from multilica.diagnosis import DecisivePair, Missing, explain
from multilica.results import PairKey
from multilica.sinks.run_state import RunState


class Failure(NamedTuple):
    """A LiDAR that was not placed.

    Args:
        stage: the stage at which it failed.
        pair: the decisive pair, as it was matched; None if there was none.
        elsewhere: the other accepted pair, which puts it at another place.
    """

    lidar: str
    stage: Stage
    pair: PairKey | None
    elsewhere: PairKey | None = None


def failures(state: RunState) -> tuple[Failure, ...]:
    """Return every LiDAR that was not placed; none for a run without a result."""
    return tuple(_failure(state, missing) for missing in explain(state.document).missing)


def decisive_failure(state: RunState) -> Failure | None:
    """Return the first failure with a registered pair, else the first with any pair, else the first."""
    return min(
        failures(state), key=lambda each: (each.pair not in state.registrations, each.pair is None), default=None
    )


def _failure(state: RunState, missing: Missing) -> Failure:
    """Return the failure with the pair that the explanation calls decisive: both are shown side by side."""
    if missing.cause in ("dead_sensor", "no_returns_in_range"):
        return Failure(missing.lidar, "preprocess", None)
    if missing.decisive is not None:
        stage: Stage = "fine" if missing.decisive.codes else "merge"
        return Failure(missing.lidar, stage, *(_as_matched(state, at) for at in (missing.decisive, missing.elsewhere)))
    if not state.matches:
        return Failure(missing.lidar, "merge", None)
    own = [pair for pair in state.pairs if missing.lidar in pair]
    pair = max(own, key=lambda pair: (state.progress_of(pair), pair), default=None)
    return Failure(missing.lidar, "coarse" if pair is not None and state.matches.get(pair) else "correspond", pair)


def _as_matched(state: RunState, pair: DecisivePair | None) -> PairKey | None:
    """Return None for a pair that is not in the state, as in a joint result."""
    sides = {pair.target, pair.source} if pair is not None else set()
    return next((key for key in state.registrations if set(key) == sides), None)
