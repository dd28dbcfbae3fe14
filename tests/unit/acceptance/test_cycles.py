# SPDX-License-Identifier: Apache-2.0
"""Cycles that accepted pairs close, and chains that beams contradict."""

from dataclasses import replace

import numpy as np
import pytest

from multilica.acceptance.rig import check_cycles, is_contradicted
from multilica.config import AcceptanceConfig
from tests.unit.acceptance.made_rig import linked, moved_to, scored, true_pose
from tests.unit.made_pairs import UNCERTAIN, pose, undecided

_CONFIG = AcceptanceConfig()


def _contradict(*names, violate=20):
    """Score poses so that beams contradict any pose between these two."""
    return lambda at: scored(at, violate=violate if {at.target, at.source} == {*names} else 0)


def _doubted(pairs, score_pose):
    return ["".join(sorted(pair.lidars)) for pair in check_cycles(pairs, score_pose, _CONFIG) if is_contradicted(pair)]


@pytest.mark.parametrize("first", [("a", "b"), ("b", "a")])
@pytest.mark.parametrize("second", [("a", "c"), ("c", "a")])
def test_a_chain_that_beams_contradict_is_doubted(first, second):
    asked = []

    def score_pose(at):
        asked.append(at)
        return scored(at, violate=20)

    after = check_cycles([linked(*first), linked(*second)], score_pose, _CONFIG)
    assert [pair.verdict.outcome for pair in after] == ["undecided", "undecided"]
    assert [pair.verdict.codes for pair in after] == [("cycle_contradicted",)] * 2
    assert "puts c where 2.0% of the points shared with b lie in proven-empty space" in after[0].verdict.text
    (implied,) = asked
    assert implied.distance_to(true_pose("b", "c")) == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(
    ("violate", "doubted"),
    [(3, []), (5, ["ac"]), (20, ["ab", "ac"])],
    ids=["strays", "what the weaker pair cannot stand", "what neither can"],
)
def test_a_contradiction_is_taken_from_the_evidence_of_each_pair(violate, doubted):
    pairs = [linked("a", "b", 3000), linked("a", "c", 300)]
    assert _doubted(pairs, _contradict("b", "c", violate=violate)) == doubted


def test_all_pairs_between_the_ends_are_doubted():
    pairs = [linked("a", "b"), linked("b", "c"), linked("c", "d")]
    assert _doubted(pairs, _contradict("a", "d")) == ["ab", "bc", "cd"]
    assert _doubted(pairs, _contradict("b", "d")) == ["bc", "cd"]


def test_consistent_pairs_are_left_as_they_are():
    pairs = [linked("a", "b"), linked("a", "c"), linked("b", "d", verdict=undecided("ambiguous"))]
    after = check_cycles(pairs, _contradict("a", "d"), _CONFIG)
    assert all(one is other for one, other in zip(after, pairs, strict=True))


def test_a_cycle_that_closes_is_not_scored():
    def score_pose(at):
        raise AssertionError(at)

    assert _doubted([linked("a", "b"), linked("a", "c"), linked("c", "b")], score_pose) == []


@pytest.mark.parametrize(
    ("evidence", "doubted"),
    [
        ((600, 600, 60), ["bc"]),
        ((600, 60, 600), ["ac"]),
        ((600, 500, 400), ["ab", "ac", "bc"]),
    ],
    ids=["the loop", "a pair of the tree", "none has clearly more"],
)
def test_of_a_cycle_that_does_not_close_the_weakest_goes(evidence, doubted):
    elsewhere = pose("b", "b", (1.0, 0.0, 0.0)) @ true_pose("b", "c")
    pairs = [linked("a", "b", evidence[0]), linked("a", "c", evidence[1])]
    pairs.append(moved_to(linked("b", "c", evidence[2]), elsewhere))
    after = check_cycles(pairs, scored, _CONFIG)
    assert ["".join(sorted(pair.lidars)) for pair in after if is_contradicted(pair)] == doubted
    assert all("one of the pairs is wrong" in pair.verdict.text for pair in after if is_contradicted(pair))


@pytest.mark.parametrize(
    ("evidence", "others", "doubted"),
    [
        ((600, 600, 60), [], ["ab", "ac", "bc"]),
        ((600, 6000, 60), [], ["ab", "bc"]),
        ((600, 600, 60), ["ad", "bd"], ["ab", "ac", "ad", "bc", "bd"]),
        ((600, 600, 60), ["ad"], ["ab", "ac", "bc"]),
    ],
    ids=["one has more", "one has much more", "another cycle shares a pair", "a pair in no cycle"],
)
def test_a_cycle_that_misses_by_a_turn_doubts_more_pairs(evidence, others, doubted):
    """Where a hall looks the same from its other end, wrong pairs confirm each other."""
    turned = pose("b", "b", (1.0, 0.0, 0.0), np.pi) @ true_pose("b", "c")
    pairs = [linked("a", "b", evidence[0]), linked("a", "c", evidence[1])]
    pairs += [moved_to(linked("b", "c", evidence[2]), turned), *(linked(*names) for names in others)]
    assert sorted(_doubted(pairs, scored)) == doubted


@pytest.mark.parametrize(
    ("hypothesis", "evidence", "doubted"),
    [(-1, 500, ["ab", "ac", "bc", "bd", "cd"]), (0, 500, ["ab", "ac", "bc"]), (-1, 5000, ["ab", "ac", "bc", "cd"])],
    ids=["where they implied it", "by a search", "by one with clearly more evidence"],
)
def test_pairs_that_implied_a_doubted_one_are_doubted(hypothesis, evidence, doubted):
    """The pairs of c with a and b are 0.2 m off each, in opposite directions, so each of the other cycles closes."""
    shift = pose("a", "a", (0.2, 0.0, 0.0))
    opposite = true_pose("b", "a") @ shift.inverse() @ true_pose("a", "b")
    pairs = [linked("a", "b", 620), linked("b", "d", evidence), linked("c", "d", 480)]
    pairs.append(moved_to(linked("a", "c", 600), shift @ true_pose("a", "c")))
    pairs.append(replace(moved_to(linked("b", "c", 400), opposite @ true_pose("b", "c")), hypothesis=hypothesis))
    assert sorted(_doubted(pairs, scored)) == doubted


def test_pairs_without_a_score_are_left_alone():
    pairs = [replace(linked("a", "b"), registrations=()), replace(linked("a", "c"), registrations=())]
    assert _doubted(pairs, _contradict("b", "c")) == []


def test_an_uncertain_pair_of_a_chain_is_doubted_first():
    pairs = [linked("a", "b"), linked("b", "c", 300, UNCERTAIN)]
    assert _doubted(pairs, _contradict("a", "c")) == ["bc"]
    assert _doubted([linked("a", "b"), linked("b", "c", 300)], _contradict("a", "c")) == ["ab", "bc"]


@pytest.mark.parametrize(("evidence", "doubted"), [(60, ["bc"]), (600, ["ab", "ac", "bc"])])
def test_an_uncertain_pair_may_contradict_a_cycle(evidence, doubted):
    elsewhere = pose("b", "b", (1.0, 0.0, 0.0)) @ true_pose("b", "c")
    uncertain = moved_to(linked("b", "c", evidence, UNCERTAIN), elsewhere)
    assert _doubted([linked("a", "b"), linked("a", "c"), uncertain], scored) == doubted
