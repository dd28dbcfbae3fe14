# SPDX-License-Identifier: Apache-2.0
"""Pairs that alone join two groups, tested with all that these groups see."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from multilica import events
from multilica.acceptance.accept import is_in_long_place
from multilica.acceptance.pair_graph import PairGraph
from multilica.config import AcceptanceConfig
from multilica.orchestration.pairs import register_sides
from multilica.orchestration.state import CalibrationState
from multilica.results import Hypothesis, PairKey, PairRegistration, Reason, Verdict, connected
from multilica.results.hypotheses import IMPLIED
from multilica.stages.fine import RegistrationCloud, prepare_registration_cloud

# A pair that may be turned has two places; more are those of things that repeat.
_REPEATED = 3


def doubt_lone_pairs(state: CalibrationState) -> None:
    """Leave pairs undecided that alone join two groups, if the groups fit as well at another pose.

    A search that finds several poses with enough evidence decides by what two LiDARs see, and their groups see more.
    Pairs that were registered where others imply them repeat what these say: between equal trees, four of them agreed
    with a wrong pair. They go with it.

    A lone pair may have found one of many places if the search of another pair found three or more, or if it is precise
    in a tunnel: the scene repeats. It then needs as much evidence as if these competed.
    """
    limits = state.config.acceptance
    found = (*state.registrations.values(), *state.searched.values())
    repeats = any(_shows_repetition(pair, limits) for pair in found)
    joining = [pair for pair in state.registrations.values() if pair.verdict.outcome in ("accept", "uncertain")]
    searched = [pair for pair in joining if pair.hypothesis != IMPLIED and pair.registrations]
    for pair in searched:
        others = [each for each in searched if each is not pair]
        members, of_source = connected(pair.target, others), connected(pair.source, others)
        if pair.source in members:
            continue
        least = limits.min_evidence + limits.min_log_odds_margin
        doubt: tuple[Reason, ...] = ()
        may_repeat = repeats or (pair.verdict.accepted and is_in_long_place(pair.registrations[0].visibility))
        if may_repeat and pair.evidence < least:
            doubt = (_little_evidence(pair, least),)
        elif len(members) + len(of_source) > 2 and _places(pair, limits) > 1:
            doubt = _competing(state, pair, others)
        for key, each in state.registrations.items():
            if doubt and each in joining and len(each.lidars & members) == len(each.lidars & of_source) == 1:
                _doubt(state, key, doubt)


def _shows_repetition(pair: PairRegistration, config: AcceptanceConfig) -> bool:
    return pair.verdict.outcome == "undecided" and _places(pair, config) >= _REPEATED


def _places(pair: PairRegistration, config: AcceptanceConfig) -> int:
    """Return the number of poses of the pair that would count by themselves."""
    return sum(each.evidence >= config.min_evidence for each in pair.registrations)


def _little_evidence(pair: PairRegistration, least: float) -> Reason:
    text = (
        f"only {pair.source} against {pair.target} joins their groups, and the scene may repeat "
        f"(evidence {pair.evidence:.1f}, needs {least:.1f})"
    )
    return Reason("held_by_repetition", pair.evidence, least, text)


def _competing(
    state: CalibrationState, pair: PairRegistration, others: Sequence[PairRegistration]
) -> tuple[Reason, ...]:
    """Return why the groups that a pair joins fit as well at another pose; nothing if they do not."""
    target, source = (_side_of(state, root, others) for root in (pair.target, pair.source))
    found = register_sides(target, source, [Hypothesis(pair.T_target_source)], state.config)
    competing = [reason for reason in found.verdict.reasons if reason.competing is not None]
    return tuple(replace(reason, competing=None) for reason in competing)


def _side_of(state: CalibrationState, root: str, pairs: Sequence[PairRegistration]) -> RegistrationCloud:
    """Prepare the LiDARs that pairs connect to the root, in its frame."""
    poses = sorted(PairGraph.of(sorted(state.clouds), pairs).poses(root).items())
    if len(poses) == 1:
        return state.lidars[root].side
    points_m = np.concatenate([pose.apply(state.clouds[name].points_m) for name, pose in poses])
    views = [(pose, view) for name, pose in poses if (view := state.lidars[name].view) is not None]
    return prepare_registration_cloud(root, points_m, views, state.config)


def _doubt(state: CalibrationState, key: PairKey, reasons: tuple[Reason, ...]) -> None:
    pair: PairRegistration = replace(state.registrations[key], verdict=Verdict("undecided", reasons))
    state.registrations[key] = pair
    state.observe(events.VerdictChanged(pair))
