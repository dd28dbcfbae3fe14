# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from multilica import testimony
from multilica.config import VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import Assessment, PairRegistration, Verdict
from multilica.stages.contradiction import doubt_by_contradiction, doubt_by_open_pairs, is_contradicted

_CONFIG = VerifyConfig()
_IN_A = {
    "a": RigidTransform.identity("a", "a"),
    "b": RigidTransform.from_xyz_rpy("a", "b", [0.5, 0.2, 0.0], [0.0, 0.0, 0.8]),
    "c": RigidTransform.from_xyz_rpy("a", "c", [-0.5, 0.1, 0.1], [0.0, 0.1, -1.2]),
    "d": RigidTransform.from_xyz_rpy("a", "d", [0.0, 0.9, 0.1], [0.1, 0.0, 2.0]),
}


def _testimony(agree=1000, violate=0):
    information = np.diag([50.0, 200, 200, 200, 200, 0.4 * agree])
    return testimony.Testimony(agree, violate, 0, 0, information, np.zeros(0, dtype=np.uint8))


def _pair(target, source, agree=1000, outcome="accept"):
    pose = _IN_A[target].inverse() @ _IN_A[source]
    best = Assessment(0, pose, _testimony(agree), 0.8, 0.03, 5.0, np.zeros((0, 3)))
    return PairRegistration(
        target,
        source,
        pose,
        0.9,
        0.1,
        10,
        converged=True,
        iterations=3,
        engine="test",
        verdict=Verdict(outcome),
        assessments=(best,),
    )


def _contradict(*names):
    """Beams contradict any pose between these two."""
    return lambda pose: _testimony(violate=20 if {pose.target, pose.source} == {*names} else 0)


def _outcomes(pairs, testify):
    return [pair.verdict.outcome for pair in doubt_by_contradiction(pairs, testify, _CONFIG)]


@pytest.mark.parametrize("first", [("a", "b"), ("b", "a")])
@pytest.mark.parametrize("second", [("a", "c"), ("c", "a")])
def test_two_pairs_that_put_a_third_into_empty_space_are_both_doubted(first, second):
    asked = []

    def testify(pose):
        asked.append(pose)
        return _testimony(violate=20)

    pairs = [_pair(*first), _pair(*second, agree=900)]
    doubted = doubt_by_contradiction(pairs, testify, _CONFIG)
    assert [pair.verdict.outcome for pair in doubted] == ["undecided", "undecided"]
    reasons = [pair.verdict.reasons[0] for pair in doubted]
    assert [reason.code for reason in reasons] == ["cycle_contradicted"] * 2
    assert reasons[0].value == pytest.approx(20 / 1020)
    assert "2.0%" in reasons[0].text
    assert f"together with {second[1]} in {second[0]}" in reasons[0].text
    implied = _IN_A[asked[0].target].inverse() @ _IN_A[asked[0].source]
    assert asked[0].distance_to(implied) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_the_pair_with_clearly_more_evidence_is_kept():
    assert _outcomes([_pair("a", "b"), _pair("a", "c", agree=600)], _contradict("b", "c")) == ["accept", "undecided"]
    assert _outcomes([_pair("a", "c", agree=600), _pair("a", "b")], _contradict("b", "c")) == ["undecided", "accept"]


def test_pairs_that_go_together_are_left_as_they_are():
    pairs = [_pair("a", "b"), _pair("a", "c"), _pair("b", "d", outcome="undecided")]
    after = doubt_by_contradiction(pairs, _contradict("a", "d"), _CONFIG)
    assert all(one is other for one, other in zip(after, pairs, strict=True))


def test_a_cycle_that_an_accepted_pair_closes_needs_no_trial():
    def testify(pose):
        raise AssertionError(pose)

    assert _outcomes([_pair("a", "b"), _pair("a", "c"), _pair("c", "b")], testify) == ["accept"] * 3


def test_pairs_that_were_never_judged_are_left_alone():
    pairs = [replace(_pair("a", "b"), assessments=()), replace(_pair("a", "c"), assessments=())]
    assert _outcomes(pairs, _contradict("b", "c")) == ["accept", "accept"]


def _open(target, source, agree=1000, turned=True, curvature=0.1, occluded=0):
    """An undecided pair that can slide, and fits elsewhere than the others imply, or where they do."""
    pair = _pair(target, source, agree)
    pose = pair.T_target_source
    if turned:
        pose = RigidTransform.from_xyz_rpy(target, target, [0.0, 1.0, 0.0], [0.0, 0.0, np.pi]) @ pose
    testimony_of = replace(pair.assessments[0].testimony, structure_agree=100, structure_occluded=occluded)
    best = replace(pair.assessments[0], T_target_source=pose, weakest_curvature=curvature, testimony=testimony_of)
    return replace(pair, T_target_source=pose, assessments=(best,), verdict=Verdict("undecided"))


def _held(pair, points):
    weakest = replace(pair.assessments[0].testimony, information=np.diag([points, 200, 200, 200, 200, 400.0]))
    return replace(pair, assessments=(replace(pair.assessments[0], testimony=weakest),))


_CHAIN = (_held(_pair("b", "a", agree=500), 20.0), _held(_pair("b", "c", agree=600), 0.1), _pair("d", "c", agree=400))


def _nothing_in_common(_):
    return _testimony(agree=0)


def test_a_chain_of_pairs_is_doubted_where_it_is_held_least_if_an_open_pair_knows_nothing_of_where_it_leads():
    doubted = doubt_by_open_pairs([*_CHAIN, _open("d", "a")], _nothing_in_common, _CONFIG)
    assert [is_contradicted(pair) for pair in doubted] == [False, True, False, False]
    assert doubted[1].verdict.outcome == "undecided"
    assert "puts a 1." in doubted[1].verdict.reasons[0].text
    assert "180 deg from where it fits d" in doubted[1].verdict.reasons[0].text


@pytest.mark.parametrize(
    ("known", "testify"),
    [
        (_open("d", "a", turned=False), _nothing_in_common),
        (_open("a", "d", turned=False), _nothing_in_common),
        (_open("d", "a"), lambda _: _testimony()),
        (_open("d", "a", agree=300), _nothing_in_common),
        (_open("d", "a", occluded=5000), _nothing_in_common),
        (_open("d", "a", curvature=5.0), _nothing_in_common),
        (replace(_open("d", "a"), verdict=Verdict("reject")), _nothing_in_common),
    ],
    ids=[
        "one of its answers",
        "the other way round",
        "seen as well",
        "less evidence",
        "unexplained",
        "doubted by others",
        "rejected",
    ],
)
def test_an_open_pair_that_goes_with_the_chain_or_is_no_witness_changes_nothing(known, testify):
    pairs = [*_CHAIN, known]
    assert doubt_by_open_pairs(pairs, testify, _CONFIG) == pairs
