# SPDX-License-Identifier: Apache-2.0
from itertools import combinations

import pytest

from multilica.stages.pair_choice import components, next_round, pairs_by_role

_NAMES = "abcd"
_PRIORITY = {pair: priority for priority, pair in enumerate(combinations(_NAMES, 2))}
"""cd is the most promising pair, ab the least."""


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
