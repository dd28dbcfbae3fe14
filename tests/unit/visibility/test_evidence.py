# SPDX-License-Identifier: Apache-2.0
"""The log-odds that a pose is true: what raises them, what lowers them, and ties but for rounding."""

from dataclasses import replace
from math import log

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multilica.config import AcceptanceConfig
from multilica.results import Registration
from multilica.results.visibility_score import (
    DISTANCE_WEIGHT,
    DISTINCTIVE_WEIGHT,
    FACING_POINTS,
    FACING_WEIGHT,
    FEW_POINTS,
    HIDDEN_WEIGHT,
    MOVED_POINTS,
    PRIOR_LOG_ODDS,
    STOP_DISTANCE_M,
    STRAY_SHARE,
    STRAY_STRUCTURE_SHARE,
    VIOLATION_WEIGHT,
    VisibilityScore,
)
from tests.unit.made_pairs import pose


def _score(agree=1000, on_the_main_plane=600.0, violate=0, **structure):
    information = np.diag([0.0, 0.0, 0.0, on_the_main_plane, 0.0, 0.0])
    return VisibilityScore(agree, violate, 0, 0, information, np.zeros(0, dtype=np.uint8), **structure)


def _registration(at, score):
    return Registration(0, at, score, 0.8, 0.03, 5.0, np.zeros((0, 3)))


def test_the_evidence_is_the_weighted_sum_of_four_logarithms():
    score = _score(violate=7, structure_agree=90, structure_occluded=60)
    assert score.distinctive == pytest.approx(400.0)
    assert score.shared_share == pytest.approx((90 + FEW_POINTS) / (90 + FEW_POINTS + 60))
    assert score.contradiction == pytest.approx(VIOLATION_WEIGHT * log(1 + 7 - STRAY_SHARE * 1000))
    expected = (
        PRIOR_LOG_ODDS
        + DISTINCTIVE_WEIGHT * log(401)
        + HIDDEN_WEIGHT * log(score.shared_share)
        - score.contradiction
        - DISTANCE_WEIGHT * log(1 + 2.5)
    )
    assert score.evidence(2.5) == pytest.approx(expected, abs=1e-6)


def test_a_pose_with_nothing_in_common_has_the_prior_odds():
    assert _score(agree=0, on_the_main_plane=0.0).evidence(0.0) == PRIOR_LOG_ODDS


@pytest.mark.parametrize(
    "worse",
    [
        {"on_the_main_plane": 900.0},
        {"violate": 10},
        {"structure_occluded": 200},
    ],
    ids=["on one plane", "in empty space", "hidden"],
)
def test_each_weakness_costs_evidence(worse):
    usual = {"structure_agree": 200}
    assert _score(**{**usual, **worse}).evidence(1.0) < _score(**usual).evidence(1.0)


def test_lidars_far_apart_need_more_evidence():
    evidence = [_score().evidence(distance_m) for distance_m in (0.0, 1.0, 3.0, 12.0)]
    assert evidence == sorted(evidence, reverse=True)
    assert evidence[0] - evidence[3] == pytest.approx(DISTANCE_WEIGHT * log(13))


def test_between_stops_a_distance_says_nothing():
    """Of two houses that look alike, the nearer one is no likelier: the vehicle has driven on."""
    score = _score(between_stops=True)
    assert score.evidence(0.0) == score.evidence(11.0) == _score().evidence(STOP_DISTANCE_M)
    here, there = (
        Registration(0, pose("t", "s", xyz_m), score, 0.9, 0.03, 1.0, np.zeros((0, 3)))
        for xyz_m in ((0.0, 0.0, 0.0), (11.0, 0.0, 0.0))
    )
    assert here.lead_over(there) == 0.0
    within = [replace(each, visibility=_score()) for each in (here, there)]
    assert within[0].lead_over(within[1]) > AcceptanceConfig().min_log_odds_margin


def test_stray_points_in_empty_space_cost_nothing():
    assert _score(agree=1000, violate=3).contradiction == 0.0
    assert _score(agree=1000, violate=4).contradiction > 0.0


def test_the_ground_does_not_excuse_objects_in_empty_space():
    """Between two rows of equal trees, the turned pose has thousands of points on the ground in common."""
    trees = {"structure_agree": 20, "structure_violate": 9}
    too_many = 9 - MOVED_POINTS - STRAY_STRUCTURE_SHARE * 20
    assert _score(agree=14000, violate=9, **trees).contradiction == pytest.approx(VIOLATION_WEIGHT * log(1 + too_many))
    assert _score(agree=14000, violate=9, structure_agree=20, structure_violate=5).contradiction == 0.0
    assert _score(agree=14000, violate=9, structure_agree=200, structure_violate=9).contradiction == 0.0
    parked = replace(_score(agree=14000, violate=9, **trees), between_stops=True)
    assert parked.contradiction == 0.0


def test_the_evidence_of_a_registration_counts_its_distance():
    near, far = (_registration(pose("t", "s", xyz_m), _score()) for xyz_m in ((0.6, 0.0, 0.8), (6.0, 0.0, 8.0)))
    assert near.evidence == _score().evidence(1.0)
    assert far.evidence == _score().evidence(10.0)
    assert replace(near, visibility=_score(violate=50)).evidence < near.evidence


@pytest.mark.parametrize("rounding", [-1e-12, 0.0, 1e-12])
def test_evidence_does_not_depend_on_rounding(rounding):
    assert _score(90, 40.0 + rounding).evidence(1.0) == _score(90, 40.0).evidence(1.0)
    assert _score(40, 40.0 + rounding).evidence(0.0) == PRIOR_LOG_ODDS


def _violating(*where, violate=None, agree=1000):
    """Score a pose that puts those of 20 points into empty space, and some among others."""
    violating = np.zeros(20, dtype=bool)
    violating[list(where)] = True
    score = _score(agree=agree, violate=len(where) if violate is None else violate)
    return replace(score, violating=violating)


def test_only_points_that_differ_tell_two_poses_apart():
    here, there = _violating(0, 1, 2), _violating(1, 2, 3, 4, 5, 6, 7, 8, 9)
    expected = VIOLATION_WEIGHT * log((7 + MOVED_POINTS) / (1 + MOVED_POINTS))
    assert there.contradiction_against(here) == pytest.approx(expected)
    assert here.contradiction_against(there) == pytest.approx(-expected)
    assert here.contradiction_against(here) == 0.0


def test_what_agrees_at_both_poses_excuses_nothing():
    """Without the others they would: 12 of 10,000 points are fewer than chance puts there."""
    here, there = _violating(agree=10_000), _violating(*range(12), agree=10_000)
    assert there.contradiction == 0.0
    assert there.evidence(1.0) == here.evidence(1.0)
    lead = here.evidence(1.0) - there.evidence_beside(here, 1.0)
    assert lead == pytest.approx(VIOLATION_WEIGHT * log((12 + MOVED_POINTS) / MOVED_POINTS), abs=1e-6)


def test_one_person_who_moved_does_not_decide_between_two_poses():
    seen = _violating(*range(4)).contradiction_against(_violating())
    assert 0.0 < seen < AcceptanceConfig().min_log_odds_margin


def test_the_evidence_beside_itself_is_the_evidence():
    score = _violating(*range(9))
    assert score.evidence_beside(score, 2.0) == score.evidence(2.0)


@given(st.lists(st.integers(0, 3), min_size=20, max_size=20), st.integers(0, 20), st.floats(0.0, 12.0))
def test_half_of_the_labels_bound_the_evidence(kinds, known, distance_m):
    """Of 20 points, some are in empty space at one pose, some at the other, some at both; all others agree."""
    kind = np.array(kinds)
    best, other = (
        replace(_score(np.count_nonzero(bad == 0), 0.0, np.count_nonzero(bad)), violating=bad > 0)
        for bad in (kind & 1, kind & 2)
    )
    labelled = kind[:known] & 2
    violate = np.count_nonzero(labelled)
    part = replace(_score(known - violate, 0.0, violate), violating=labelled > 0)
    assert part.most_beside(best, distance_m, 20 - known) >= other.evidence_beside(best, distance_m)
    assert part.most_beside(best, distance_m, 21 - known) == np.inf


@pytest.mark.parametrize("other", [_score(violate=5), replace(_score(violate=5), violating=np.ones(5, dtype=bool))])
def test_without_labels_only_the_counts_are_compared(other):
    score = _violating(*range(9))
    assert score.contradiction_against(other) == score.contradiction - other.contradiction
    assert other.evidence_beside(score, 2.0) == other.evidence(2.0)


_ALONG_X, _NOTHING = (1.0, 0.0, 0.0), None


def _facing(*normals):
    """Make a score with twelve labelled points for each normal; None: these do not agree."""
    of_points = [normal for normal in normals for _ in range(12)]
    agreeing = [number for number, normal in enumerate(of_points) if normal is not None]
    return _score(
        violating=np.zeros(len(of_points), dtype=bool),
        agreeing=np.array(agreeing, dtype=np.int32),
        agreeing_normals=np.array([of_points[number] for number in agreeing], dtype=np.float16).reshape(-1, 3),
    )


def test_facing_points_that_agree_at_one_pose_only_decide():
    true, slid = _facing(_ALONG_X, (0, 1, 0), _ALONG_X), _facing(_NOTHING, _NOTHING, _ALONG_X)
    lead = true.lead_along(slid, np.array([1.0, 0.0, 0.0]))
    assert lead == pytest.approx(FACING_WEIGHT * log((12 + FACING_POINTS) / FACING_POINTS))
    assert slid.lead_along(true, np.array([-1.0, 0.0, 0.0])) == pytest.approx(-lead)


def test_a_wall_along_the_shift_tells_nothing():
    assert _facing((0, 1, 0)).lead_along(_facing(_NOTHING), np.array([1.0, 0.0, 0.0])) == 0.0


def test_points_that_are_not_known_to_be_the_same_tell_nothing():
    assert _facing(_ALONG_X).lead_along(_score(), np.array([1.0, 0.0, 0.0])) == 0.0
    assert _score().lead_along(_score(), np.array([1.0, 0.0, 0.0])) == 0.0


@pytest.mark.parametrize(("turn_rad", "tells"), [(0.0, True), (0.05, True), (0.1, False), (np.pi, False)])
def test_facing_points_compare_poses_of_the_same_attitude(turn_rad, tells):
    score, slid = _facing(_ALONG_X), _facing(_NOTHING)
    best = _registration(pose("t", "s", (1.0, 0.0, 0.0)), score)
    other = _registration(pose("t", "s", (4.0, 0.0, 0.0), turn_rad), slid)
    added = score.lead_along(slid, np.array([1.0, 0.0, 0.0])) if tells else 0.0
    assert added > 1.0 or not tells
    assert best.lead_over(other) == pytest.approx(best.rough_lead_over(other) + added)
    assert other.lead_over(best) == pytest.approx(-best.lead_over(other), abs=1e-5)


def test_a_pose_does_not_lead_itself():
    same = _registration(pose("t", "s", (1.0, 0.0, 0.0)), _facing(_ALONG_X))
    assert same.lead_over(same) == 0.0
