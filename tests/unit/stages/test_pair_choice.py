# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from multilica.results import Verdict
from multilica.stages.pair_choice import choose_loops, components, implied_poses, is_open, next_round, pairs_by_role
from tests.unit.made_pairs import ACCEPTED, pair, pose, registration, undecided

_PLACED = pose("a", "b", (1.0, 0.0, 0.0))
_ELSEWHERE = pose("a", "b", (0.0, 4.0, 0.0))
_PAIRS = list(combinations("abcd", 2))
_NAMES = "abcd"
_PRIORITY = {pair: priority for priority, pair in enumerate(combinations(_NAMES, 2))}
"""cd is the most promising pair, ab the least."""


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


def _round(accepted=(), tried=(), priority=None):
    return [
        "".join(pair)
        for pair in next_round(_NAMES, [*map(tuple, accepted)], {*map(tuple, tried)}, priority or _PRIORITY)
    ]


def test_components_are_named_by_their_first_member():
    found = components("abcde", [("d", "b"), ("e", "c"), ("b", "e")])
    assert found == {"a": "a", "b": "b", "c": "b", "d": "b", "e": "b"}


def test_the_first_round_has_the_best_pair_of_each_lidar():
    assert _round() == ["cd", "bd", "ad"]


def test_pairs_within_a_group_are_not_searched():
    assert _round(accepted=["cd", "bd"]) == ["ad"]
    assert _round(accepted=["cd", "ab"]) == ["bd"]
    assert _round(accepted=["ab", "bc", "cd"]) == []


def test_the_next_best_pair_follows_one_that_was_tried():
    assert _round(accepted=["cd", "bd"], tried=["cd", "bd", "ad"]) == ["ac"]
    assert _round(tried=["cd", "bd", "ad"]) == ["bc", "ac"]


def test_a_group_that_tried_all_ways_out_is_left():
    assert _round(accepted=["cd"], tried=["cd", "ab", "ac", "ad"]) == ["bd"]
    assert _round(tried=["".join(pair) for pair in _PRIORITY]) == []


@pytest.mark.parametrize("order", [1, -1])
def test_equal_promise_does_not_depend_on_the_order_of_pairs(order):
    equal = dict.fromkeys([*_PRIORITY][::order], 0.5)
    assert _round(priority=equal) == ["ab", "ac", "ad"]


def test_a_chain_of_rounds_needs_one_search_less_than_lidars():
    accepted, searched = [], []
    while pairs := _round(accepted, searched):
        searched += pairs
        accepted += pairs
    assert len(searched) == len(_NAMES) - 1


@pytest.mark.parametrize(
    ("mode", "pairs"),
    [("target_first", "ba bc"), ("algorithm1", "ab ac ba bc ca cb"), ("graph", "ab ac bc")],
)
def test_the_mode_of_the_merge_gives_the_roles(mode, pairs):
    assert ["".join(pair) for pair in pairs_by_role("abc", "b", mode)] == pairs.split()
