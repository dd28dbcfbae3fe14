# SPDX-License-Identifier: Apache-2.0
"""Groups that accepted pairs link, and registrations of groups that none links."""

from itertools import permutations

import numpy as np
import pytest

from multilica.results import Verdict
from multilica.stages.merge import merge_along_graph
from tests.unit.made_pairs import ACCEPTED, pair, pose, undecided

_PLACES = {name: pose("world", name, (index, 2.0 * index, 0.5), -0.3 * index) for index, name in enumerate("TABCD")}
_UNCERTAIN = Verdict("uncertain", undecided("imprecise").reasons)
_REFUSED = undecided("not_observable")


def _pair(target, source, evidence=0.9, verdict=ACCEPTED):
    """Make a pair at its true pose; its fitness stands for its evidence."""
    return pair(_PLACES[target].inverse() @ _PLACES[source], verdict, evidence)


def _run(pairs, names="TABCD", register=pytest.fail):
    return list(merge_along_graph("T", list(names), pairs, register))


def _assert_true_poses(group):
    for name, placed in group.poses.items():
        assert np.allclose(placed.matrix, (_PLACES["T"].inverse() @ _PLACES[name]).matrix, atol=1e-9)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("evidence", list(permutations([3.0, 5.0, 7.0, 9.0])))
def test_a_chain_is_placed_in_any_order_of_its_pairs(evidence, turned):
    chain = [pair[:: -1 if turned else 1] for pair in ("TC", "CB", "BA", "AD")]
    steps = _run([_pair(*each, of_pair) for each, of_pair in zip(chain, evidence, strict=True)])
    assert [step.chosen.fitness for step in steps] == [9.0, 7.0, 5.0, 3.0]
    final = steps[-1].groups[0]
    assert (final.root, final.members) == ("T", tuple("ABCDT"))
    _assert_true_poses(final)


def test_no_group_is_registered_that_an_accepted_pair_joins():
    refused = _pair("T", "B", 8.0, _REFUSED)
    steps = _run([_pair("T", "A"), refused, _pair("A", "B", 0.1)], "TAB")
    assert [step.chosen.source for step in steps] == ["A", "B"]
    assert all(step.decision.chosen.passes for step in steps)


def test_groups_without_an_accepted_pair_are_registered_once():
    calls = []

    def register(group, other, pairs):
        calls.append((group.members, other.members, [each.lidars for each in pairs]))
        return _pair(group.root, other.root, 4.0)

    between = [_pair("B", "C", 0.3, _REFUSED), _pair("T", "B", 0.2, _REFUSED)]
    steps = _run([_pair("T", "A"), _pair("C", "D"), *between], register=register)
    assert calls[0] == (("A", "T"), ("B",), [{"T", "B"}])
    assert calls[1] == (("B",), ("C", "D"), [{"B", "C"}])
    assert len({(group, other) for group, other, _ in calls}) == len(calls)
    assert steps[-1].groups[0].members == tuple("ABCDT")
    _assert_true_poses(steps[-1].groups[0])


def test_two_single_lidars_are_not_registered_again():
    (step,) = _run([_pair("T", "A", 0.5, _REFUSED)], "TA")
    assert step.decision.chosen is None
    assert step.decision.reason == "stopped: the only pair left, A in T, is not accepted: made not_observable"


def test_an_uncertain_pair_joins_what_nothing_else_joins():
    pairs = [_pair("T", "A", 9.0, _UNCERTAIN), _pair("T", "B", 3.0), _pair("B", "A", 2.0)]
    assert [step.chosen.verdict.outcome for step in _run(pairs, "TAB")] == ["accept", "accept"]
    steps = _run(pairs[:2], "TAB", lambda *_: None)
    assert [step.chosen.verdict.outcome for step in steps] == ["accept", "uncertain"]
    assert steps[1].decision.chosen.uncertain
    assert "uncertain, and no accepted pair is left: made imprecise" in steps[1].decision.reason


def test_an_accepted_group_comes_before_an_uncertain_pair():
    pairs = [_pair("T", "B"), _pair("T", "A", 9.0, _UNCERTAIN)]
    steps = _run(pairs, "TAB", lambda group, other, _: _pair(group.root, other.root, 4.0))
    assert [step.chosen.verdict.outcome for step in steps] == ["accept", "accept"]


def test_a_lidar_without_any_registration_is_left():
    steps = _run([_pair("T", "A")], "TAB")
    assert steps[-1].decision.groups == (("A", "T"), ("B",))
    assert steps[-1].decision.reason == "stopped: no pair is left that could be registered"


def test_the_larger_group_keeps_its_root():
    pairs = [_pair("A", "B", 9.0), _pair("C", "B", 8.0), _pair("D", "C", 7.0)]
    steps = _run(pairs, register=lambda *_: None)
    assert [step.grown.root for step in steps[:3]] == ["A", "A", "A"]
    assert steps[2].groups[1].members == tuple("ABCD")


def test_larger_groups_come_first_behind_that_of_the_target():
    step, *_ = _run([_pair("B", "C")], "TABC", register=lambda *_: None)
    assert step.decision.groups == (("T",), ("B", "C"), ("A",))
