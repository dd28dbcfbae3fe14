# SPDX-License-Identifier: Apache-2.0
"""Chains of accepted pairs that an undecided pair with more evidence excludes."""

from dataclasses import replace

import pytest

from multilica.acceptance.rig import check_ambiguous_chains, excluded_lidars, is_contradicted
from multilica.config import AcceptanceConfig
from multilica.results import Stability, Verdict
from tests.unit.acceptance.made_rig import IN_A, linked, moved_to, scored, true_pose
from tests.unit.made_pairs import UNCERTAIN, pose, undecided

_CONFIG = AcceptanceConfig()
_SLIDES = Stability(sigma_m=0.005, sigma_rad=1e-4, perturbation_m=0.3, perturbed_offset_m=0.3, thinned_offset_m=0.0)
_CHAIN = (linked("b", "a", 500), linked("b", "c", 300), linked("d", "c", 400))


def _undecided(target, source, distinctive=600, *, turned=True, stability=_SLIDES):
    """Make an undecided pair; turned: its pose is not the one that the other pairs imply."""
    made = linked(target, source, distinctive, undecided("not_observable"))
    if turned:
        made = moved_to(made, pose(target, target, (0.0, 1.0, 0.0), 3.1) @ true_pose(target, source))
    return replace(made, registrations=(replace(made.registrations[0], stability=stability),))


def _nothing_in_common(at):
    return scored(at, 0)


def test_the_weakest_pair_of_an_excluded_chain_is_doubted():
    doubted = check_ambiguous_chains([*_CHAIN, _undecided("d", "a")], _nothing_in_common, _CONFIG)
    assert [is_contradicted(pair) for pair in doubted] == [False, True, False, False]
    assert doubted[1].verdict.outcome == "undecided"
    assert "178 deg from where a fits d, so one of the pairs is wrong" in doubted[1].verdict.text


def test_an_uncertain_pair_of_an_excluded_chain_is_doubted_first():
    chain = [_CHAIN[0], _CHAIN[1], replace(_CHAIN[2], verdict=UNCERTAIN)]
    doubted = check_ambiguous_chains([*chain, _undecided("d", "a")], _nothing_in_common, _CONFIG)
    assert [is_contradicted(pair) for pair in doubted] == [False, False, True, False]


def test_pairs_are_doubted_until_no_chain_is_left():
    further = linked("b", "d", 350)
    doubted = check_ambiguous_chains([*_CHAIN, further, _undecided("d", "a")], _nothing_in_common, _CONFIG)
    assert [is_contradicted(pair) for pair in doubted] == [False, True, False, True, False]


@pytest.mark.parametrize(
    ("known", "score_pose"),
    [
        (_undecided("d", "a", turned=False), _nothing_in_common),
        (_undecided("a", "d", turned=False), _nothing_in_common),
        (_undecided("d", "a"), scored),
        (_undecided("d", "a", 200), _nothing_in_common),
        (_undecided("d", "a", stability=None), _nothing_in_common),
        (replace(_undecided("d", "a"), verdict=Verdict("reject")), _nothing_in_common),
    ],
    ids=["one of its poses", "the other way round", "scores as well", "less evidence", "doubted by others", "rejected"],
)
def test_an_undecided_pair_that_excludes_no_chain_is_ignored(known, score_pose):
    pairs = [*_CHAIN, known]
    after = check_ambiguous_chains(pairs, score_pose, _CONFIG)
    assert all(one is other for one, other in zip(after, pairs, strict=True))


def test_the_rig_excludes_both_lidars_of_an_undecided_pair():
    """Nothing says which of the two is wrong; the target has no pose to lose."""
    lost = excluded_lidars("a", IN_A, [*_CHAIN, _undecided("d", "b")], _nothing_in_common, _CONFIG)
    assert {name: reason.code for name, reason in lost.items()} == dict.fromkeys("bd", "cycle_contradicted")
    assert "178 deg from where b fits d" in lost["b"].text
    assert excluded_lidars("a", IN_A, [_undecided("d", "a")], _nothing_in_common, _CONFIG).keys() == {"d"}


@pytest.mark.parametrize(
    ("known", "score_pose"),
    [
        (_undecided("d", "b", turned=False), _nothing_in_common),
        (_undecided("d", "b"), scored),
        (_undecided("d", "b", stability=None), _nothing_in_common),
    ],
    ids=["one of its poses", "scores as well", "doubted by others"],
)
def test_an_undecided_pair_may_agree_with_the_rig(known, score_pose):
    assert excluded_lidars("a", IN_A, [*_CHAIN, known], score_pose, _CONFIG) == {}


def test_a_pair_without_both_poses_excludes_nothing():
    poses = {name: pose for name, pose in IN_A.items() if name != "d"}
    assert excluded_lidars("a", poses, [_undecided("d", "b")], _nothing_in_common, _CONFIG) == {}


def test_a_much_less_likely_pose_of_its_own_is_no_excuse():
    known = _undecided("d", "b")
    known = replace(known, registrations=(*known.registrations, scored(true_pose("d", "b"), 0)))
    assert excluded_lidars("a", IN_A, [known], _nothing_in_common, _CONFIG).keys() == {"b", "d"}
