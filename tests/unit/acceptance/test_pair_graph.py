# SPDX-License-Identifier: Apache-2.0
from itertools import permutations, product

import pytest

from multilica.acceptance.pair_graph import PairGraph
from tests.unit.acceptance.made_rig import linked, true_pose
from tests.unit.made_pairs import UNCERTAIN

_EXACT = pytest.approx((0.0, 0.0), abs=1e-9)


def _names(pairs):
    return [(pair.target, pair.source) for pair in pairs]


@pytest.mark.parametrize("turned", product([False, True], repeat=3))
def test_a_chain_implies_the_pose_of_its_ends(turned):
    chain = [pair[::-1] if swap else pair for pair, swap in zip(("ab", "bc", "cd"), turned, strict=True)]
    graph = PairGraph.of("abcd", [linked(*pair) for pair in chain])
    for target, source in permutations("abcd", 2):
        implied = graph.implied(target, source)
        assert (implied.target, implied.source) == (target, source)
        assert implied.distance_to(true_pose(target, source)) == _EXACT
    assert [pair.lidars for pair in graph.path("d", "a")] == [{*"cd"}, {*"bc"}, {*"ab"}]


def test_the_poses_of_a_group_are_in_the_frame_of_the_lidar():
    graph = PairGraph.of("abcd", [linked("b", "a"), linked("b", "c")])
    poses = graph.poses("c")
    assert {*poses} == {*"abc"}
    assert all(poses[name].distance_to(true_pose("c", name)) == _EXACT for name in "abc")
    assert {*graph.poses("d")} == {"d"}


def test_nothing_links_lidars_of_different_groups():
    graph = PairGraph.of("abcd", [linked("a", "b"), linked("c", "d")])
    assert graph.implied("a", "c") is None
    assert graph.path("a", "c") == []
    assert graph.path("a", "a") == []


@pytest.mark.parametrize("order", permutations([("a", "b", 900), ("a", "c", 500), ("c", "b", 700)]))
def test_the_tree_has_the_pairs_with_the_most_evidence(order):
    graph = PairGraph.of("abc", [linked(*pair) for pair in order])
    assert _names(graph.tree) == [("a", "b"), ("c", "b")]
    assert _names(graph.loops) == [("a", "c")]


def test_uncertain_pairs_come_after_accepted_ones():
    graph = PairGraph.of("abc", [linked("a", "b", 900, UNCERTAIN), linked("a", "c", 500), linked("c", "b", 700)])
    assert _names(graph.tree) == [("c", "b"), ("a", "c")]
    assert _names(graph.loops) == [("a", "b")]
