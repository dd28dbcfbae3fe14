# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from multilica.acceptance.cycles import check_ambiguous_chains, check_cycle_consistency, is_contradicted
from multilica.config import AcceptanceConfig, StabilityConfig
from multilica.geometry import RigidTransform
from multilica.results import PairRegistration, Registration, Verdict, VisibilityScore

_CONFIG, _LIMITS = AcceptanceConfig(), StabilityConfig()
_IN_A = {
    "a": RigidTransform.identity("a", "a"),
    "b": RigidTransform.from_xyz_rpy("a", "b", [0.5, 0.2, 0.0], [0.0, 0.0, 0.8]),
    "c": RigidTransform.from_xyz_rpy("a", "c", [-0.5, 0.1, 0.1], [0.0, 0.1, -1.2]),
    "d": RigidTransform.from_xyz_rpy("a", "d", [0.0, 0.9, 0.1], [0.1, 0.0, 2.0]),
}


def _visibility(agree=1000, violate=0):
    information = np.diag([50.0, 200, 200, 200, 200, 0.4 * agree])
    return VisibilityScore(agree, violate, 0, 0, information, np.zeros(0, dtype=np.uint8))


def _registration(pose, agree=1000, violate=0):
    return Registration(0, pose, _visibility(agree, violate), 0.8, 0.03, 5.0, np.zeros((0, 3)))


def _pair(target, source, agree=1000, outcome="accept"):
    pose = _IN_A[target].inverse() @ _IN_A[source]
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
        registrations=(_registration(pose, agree),),
    )


def _contradict(*names):
    """Score poses so that beams contradict any pose between these two."""
    return lambda pose: _registration(pose, violate=20 if {pose.target, pose.source} == {*names} else 0)


def _outcomes(pairs, score_pose):
    return [pair.verdict.outcome for pair in check_cycle_consistency(pairs, score_pose, _CONFIG)]


@pytest.mark.parametrize("first", [("a", "b"), ("b", "a")])
@pytest.mark.parametrize("second", [("a", "c"), ("c", "a")])
def test_two_pairs_that_contradict_each_other_are_doubted(first, second):
    asked = []

    def score_pose(pose):
        asked.append(pose)
        return _registration(pose, violate=20)

    pairs = [_pair(*first), _pair(*second, agree=900)]
    doubted = check_cycle_consistency(pairs, score_pose, _CONFIG)
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


def test_consistent_pairs_are_left_as_they_are():
    pairs = [_pair("a", "b"), _pair("a", "c"), _pair("b", "d", outcome="undecided")]
    after = check_cycle_consistency(pairs, _contradict("a", "d"), _CONFIG)
    assert all(one is other for one, other in zip(after, pairs, strict=True))


def test_a_cycle_closed_by_an_accepted_pair_is_not_scored():
    def score_pose(pose):
        raise AssertionError(pose)

    assert _outcomes([_pair("a", "b"), _pair("a", "c"), _pair("c", "b")], score_pose) == ["accept"] * 3


def test_pairs_without_a_score_are_left_alone():
    pairs = [replace(_pair("a", "b"), registrations=()), replace(_pair("a", "c"), registrations=())]
    assert _outcomes(pairs, _contradict("b", "c")) == ["accept", "accept"]


def _undecided(target, source, agree=1000, turned=True, curvature=0.1, occluded=0):
    """Make an undecided pair that slides; turned: its pose is not the one that the other pairs imply."""
    pair = _pair(target, source, agree)
    pose = pair.T_target_source
    if turned:
        pose = RigidTransform.from_xyz_rpy(target, target, [0.0, 1.0, 0.0], [0.0, 0.0, np.pi]) @ pose
    score = replace(pair.registrations[0].visibility, structure_agree=100, structure_occluded=occluded)
    best = replace(pair.registrations[0], T_target_source=pose, weakest_curvature=curvature, visibility=score)
    return replace(pair, T_target_source=pose, registrations=(best,), verdict=Verdict("undecided"))


def _constrained(pair, points):
    weakest = replace(pair.registrations[0].visibility, information=np.diag([points, 200, 200, 200, 200, 400.0]))
    return replace(pair, registrations=(replace(pair.registrations[0], visibility=weakest),))


_CHAIN = (
    _constrained(_pair("b", "a", agree=500), 20.0),
    _constrained(_pair("b", "c", agree=600), 0.1),
    _pair("d", "c", agree=400),
)


def _nothing_in_common(pose):
    return _registration(pose, agree=0)


def test_the_loosest_pair_of_an_excluded_chain_is_doubted():
    doubted = check_ambiguous_chains([*_CHAIN, _undecided("d", "a")], _nothing_in_common, _CONFIG, _LIMITS)
    assert [is_contradicted(pair) for pair in doubted] == [False, True, False, False]
    assert doubted[1].verdict.outcome == "undecided"
    assert "puts a 1." in doubted[1].verdict.reasons[0].text
    assert "180 deg from where a fits d with more evidence" in doubted[1].verdict.reasons[0].text


@pytest.mark.parametrize(
    ("known", "score_pose"),
    [
        (_undecided("d", "a", turned=False), _nothing_in_common),
        (_undecided("a", "d", turned=False), _nothing_in_common),
        (_undecided("d", "a"), _registration),
        (_undecided("d", "a", agree=300), _nothing_in_common),
        (_undecided("d", "a", occluded=5000), _nothing_in_common),
        (_undecided("d", "a", curvature=5.0), _nothing_in_common),
        (replace(_undecided("d", "a"), verdict=Verdict("reject")), _nothing_in_common),
    ],
    ids=[
        "one of its poses",
        "the other way round",
        "scores as well",
        "less evidence",
        "unexplained",
        "doubted by others",
        "rejected",
    ],
)
def test_an_undecided_pair_that_excludes_no_chain_is_ignored(known, score_pose):
    pairs = [*_CHAIN, known]
    assert check_ambiguous_chains(pairs, score_pose, _CONFIG, _LIMITS) == pairs
