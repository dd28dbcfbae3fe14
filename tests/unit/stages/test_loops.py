# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from multilica.results import Verdict
from multilica.stages.pair_choice import choose_loops, implied_poses, is_open
from tests.unit.made_pairs import ACCEPTED, pair, pose, registration, undecided

_PLACED = pose("a", "b", (1.0, 0.0, 0.0))
_ELSEWHERE = pose("a", "b", (0.0, 4.0, 0.0))
_PAIRS = list(combinations("abcd", 2))


def test_accepted_pairs_imply_the_poses_of_others():
    third = pose("a", "c", (0.0, 2.0, 0.0), 0.5)
    poses = implied_poses("abcd", _PAIRS, [pair(_PLACED), pair(third.inverse())])
    assert list(poses) == [("b", "c")]
    assert poses["b", "c"].distance_to(_PLACED.inverse() @ third) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_an_accepted_pair_is_no_loop():
    chain = [pair(_PLACED), pair(pose("c", "b")), pair(pose("c", "a", (-1.0, 0.0, 0.0)))]
    assert implied_poses("abc", list(combinations("abc", 2)), chain) == {}


@pytest.mark.parametrize(
    ("before", "opened"),
    [
        (pair(_PLACED, undecided("not_observable")), False),
        (pair(_PLACED.inverse(), undecided("not_observable")), False),
        (pair(_PLACED, Verdict("uncertain", undecided("imprecise").reasons)), False),
        (pair(_ELSEWHERE, undecided("not_observable")), True),
        (pair(_PLACED, undecided("ambiguous")), True),
        (pair(_PLACED, undecided("ambiguous", "not_observable")), True),
        (pair(_PLACED, ACCEPTED), False),
        (None, True),
    ],
    ids=["slides", "the other way round", "uncertain", "elsewhere", "ambiguous", "both", "accepted", "none"],
)
def test_a_loop_is_open_unless_the_scene_refused_its_pose(before, opened):
    assert is_open(before, _PLACED) is opened


def _scored(target, source, agree):
    made = registration(pose(target, source))
    information = np.diag([50.0, 200, 200, 200, 200, 400])
    return replace(made, visibility=replace(made.visibility, agree=agree + 400, information=information))


def test_loops_with_the_most_evidence_come_first():
    scores = {each: _scored(*each, agree) for agree, each in zip((100, 500, 30, 900), _PAIRS, strict=False)}
    assert choose_loops(scores, 2.3) == [("b", "c"), ("a", "c"), ("a", "b")]


def test_further_loops_of_a_lidar_that_has_enough_are_left_out():
    names = "abcdefgh"
    scores = {each: _scored(*each, 500) for each in combinations(names, 2)}
    chosen = choose_loops(scores, 2.3)
    counts = [sum(name in each for each in chosen) for name in names]
    assert max(counts) == 4
    assert min(counts) >= 2
    assert len(chosen) < len(scores)
