# SPDX-License-Identifier: Apache-2.0
from itertools import combinations

import pytest

from multilica.results import Verdict
from multilica.stages.wider_search import unconnected_pairs
from tests.unit.made_pairs import pair, pose, undecided

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
