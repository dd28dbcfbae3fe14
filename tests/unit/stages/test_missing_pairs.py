# SPDX-License-Identifier: Apache-2.0
from itertools import combinations

import pytest

from multilica.results import Group, Verdict
from multilica.stages.missing_pairs import open_loops, unconnected_pairs
from tests.unit.made_pairs import ACCEPTED, pair, pose, undecided

_PAIRS = list(combinations("abcd", 2))


def test_connected_pairs_are_not_searched_again():
    registrations = {("a", "b"): pair(pose("a", "b")), ("b", "c"): pair(pose("c", "b"))}
    assert unconnected_pairs(_PAIRS, registrations, ()) == (("a", "d"), ("b", "d"), ("c", "d"))


@pytest.mark.parametrize(
    ("verdict", "searched"),
    [
        (undecided("not_observable"), False),
        (undecided("ambiguous", "not_observable"), False),
        (undecided("ambiguous"), True),
        (undecided("empty_space_violated", "not_observable"), True),
        (Verdict("reject", undecided("too_little_overlap").reasons), True),
    ],
)
def test_an_unconstrained_pair_is_not_searched_again(verdict, searched):
    found = unconnected_pairs([("a", "b")], {("a", "b"): pair(pose("a", "b"), verdict)}, ())
    assert found == ((("a", "b"),) if searched else ())


def test_a_pair_that_others_doubt_is_not_searched_again():
    registrations = {("a", "b"): pair(pose("a", "b"), undecided("ambiguous"))}
    assert unconnected_pairs([("a", "b")], registrations, {("a", "b")}) == ()


def test_a_pair_without_a_registration_is_searched_again():
    assert unconnected_pairs([("a", "b")], {}, ()) == (("a", "b"),)


_PLACED = pose("a", "b", (1.0, 0.0, 0.0))
_ELSEWHERE = pose("a", "b", (0.0, 4.0, 0.0))
_RIG = Group("a", {"a": pose("a", "a"), "b": _PLACED})


@pytest.mark.parametrize(
    ("before", "is_open"),
    [
        (pair(_PLACED, undecided("not_observable")), False),
        (pair(_PLACED.inverse(), undecided("not_observable")), False),
        (pair(_ELSEWHERE, undecided("not_observable")), True),
        (pair(_PLACED, undecided("ambiguous")), True),
        (pair(_PLACED, undecided("ambiguous", "not_observable")), True),
        (pair(_PLACED, ACCEPTED), False),
        (None, True),
    ],
    ids=["unconstrained there", "the other way round", "elsewhere", "ambiguous", "both", "accepted", "no registration"],
)
def test_a_loop_is_open_unless_the_scene_refused_its_pose(before, is_open):
    loops = open_loops(_RIG, [("a", "b")], {} if before is None else {("a", "b"): before})
    assert list(loops) == ([("a", "b")] if is_open else [])
    assert all(implied.distance_to(_PLACED) == pytest.approx((0.0, 0.0)) for implied in loops.values())


def test_the_pose_of_a_loop_is_that_of_the_rig():
    third = pose("a", "c", (0.0, 2.0, 0.0), 0.5)
    rig = Group("a", {**_RIG.poses, "c": third})
    registrations = {("a", "b"): pair(_PLACED), ("a", "c"): pair(third)}
    loops = open_loops(rig, [("a", "b"), ("a", "c"), ("b", "c")], registrations)
    assert list(loops) == [("b", "c")]
    assert loops["b", "c"].distance_to(_PLACED.inverse() @ third) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_lidar_that_is_not_placed_has_no_loop():
    assert open_loops(_RIG, [("a", "c"), ("b", "c")], {}) == {}
