# SPDX-License-Identifier: Apache-2.0
from itertools import permutations

import numpy as np
import pytest

from multilica.geometry import RigidTransform
from multilica.results import PairRegistration, Reason, Verdict
from multilica.stages.merge import merge_by_fitness, merge_target_first

_TRUTH = {
    name: RigidTransform.from_xyz_rpy("world", name, [index, 2.0 * index, 0.5], [0.1 * index, 0.2, -0.3 * index])
    for index, name in enumerate("TABCD")
}


def _pair(target, source, fitness):
    return PairRegistration(
        target=target,
        source=source,
        T_target_source=_TRUTH[target].inverse() @ _TRUTH[source],
        fitness=fitness,
        rmse_m=0.05,
        inliers=100,
        converged=True,
        iterations=3,
        engine="test",
        verdict=Verdict("accept")
        if fitness >= 0.2
        else Verdict("reject", (Reason("low_fitness", fitness, 0.2, f"fitness {fitness}"),)),
    )


class _Overlaps:
    """Registrations of groups at their true poses; the fitness is the best of the members' overlaps, as given."""

    def __init__(self, fitness):
        self.fitness = {frozenset(pair): value for pair, value in fitness.items()}
        self.calls = []

    def pairs(self, names, *, flip=False):
        ordered = [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
        return [_pair(*(reversed(pair) if flip else pair), self.fitness.get(frozenset(pair), 0.05)) for pair in ordered]

    def register_again(self, group, other, pair):
        assert (pair.target, pair.source) == (group.root, other.root)
        return self.register_rest(group, other)

    def register_rest(self, group, other):
        self.calls.append((group.members, other.members))
        best = max(self.fitness.get(frozenset((a, b)), 0.05) for a in group.members for b in other.members)
        return _pair(group.root, other.root, best)


def _run(overlaps, names, mode="algorithm1", *, flip=False):
    pairs = overlaps.pairs(names, flip=flip)
    if mode == "target_first":
        return list(merge_target_first("T", names, pairs, overlaps.register_rest))
    return list(merge_by_fitness("T", names, pairs, overlaps.register_again))


def _assert_true_poses(group):
    for name, pose in group.poses.items():
        assert np.allclose(pose.matrix, (_TRUTH["T"].inverse() @ _TRUTH[name]).matrix, atol=1e-9)


@pytest.mark.parametrize("flip", [False, True])
@pytest.mark.parametrize("fitness", list(permutations([0.3, 0.5, 0.7, 0.9])))
def test_a_chain_is_placed_in_any_order_of_its_pairs(fitness, flip):
    chain = [("T", "C"), ("C", "B"), ("B", "A"), ("A", "D")]
    steps = _run(_Overlaps(dict(zip(chain, fitness, strict=True))), list("TABCD"), flip=flip)
    final = steps[-1].groups[0]
    assert final.root == "T"
    assert final.members == tuple("ABCDT")
    _assert_true_poses(final)
    assert all(step.decision.chosen is not None for step in steps)


def test_the_best_pair_is_merged_first():
    steps = _run(_Overlaps({("T", "A"): 0.4, ("B", "A"): 0.9}), list("TAB"))
    assert {steps[0].decision.chosen.target, steps[0].decision.chosen.source} == {"A", "B"}
    assert steps[0].decision.groups == (("T",), ("A", "B"))


def test_a_lidar_without_overlap_is_left_with_a_reason():
    steps = _run(_Overlaps({("T", "A"): 0.8}), list("TAB"))
    last = steps[-1].decision
    assert last.chosen is None
    assert last.groups == (("A", "T"), ("B",))
    assert last.reason.endswith("fitness 0.05")
    assert [candidate.passes for candidate in last.candidates] == [False]


def test_the_rest_is_registered_against_the_grown_cloud():
    overlaps = _Overlaps({("T", "A"): 0.8, ("A", "B"): 0.6})
    _run(overlaps, list("TAB"))
    assert overlaps.calls == [(("A", "T"), ("B",))]


def test_target_first_takes_direct_pairs_as_they_are():
    overlaps = _Overlaps({("T", "A"): 0.5, ("T", "B"): 0.6, ("A", "B"): 0.9, ("B", "C"): 0.7})
    steps = _run(overlaps, list("TABC"), "target_first")
    assert [step.decision.chosen.source for step in steps] == ["B", "A", "C"]
    assert overlaps.calls == [(("A", "B", "T"), ("C",))]


def test_target_first_registers_the_rest_once():
    overlaps = _Overlaps({("T", "A"): 0.5, ("A", "B"): 0.9, ("B", "C"): 0.7})
    steps = _run(overlaps, list("TABC"), "target_first")
    assert [step.decision.groups for step in steps][-1] == (("A", "B", "T"), ("C",))
    assert overlaps.calls == [(("A", "T"), ("B",)), (("A", "T"), ("C",))]
    assert steps[-1].decision.chosen is None


@pytest.mark.parametrize("direction", [("A", "B"), ("B", "A")])
def test_what_a_merged_source_shares_with_others_is_dropped(direction):
    """As the paper's Algorithm 1: what A shares with T is lost with A, unless it grew the cloud of B."""
    target, source = direction
    overlaps = _Overlaps({})
    pairs = [_pair(target, source, 0.9), _pair("T", source, 0.8), _pair("T", target, 0.1)]
    steps = list(merge_by_fitness("T", list("TAB"), pairs, overlaps.register_again))
    assert overlaps.calls == [(("T",), ("A", "B"))]
    assert steps[-1].decision.groups == (("T",), ("A", "B"))


def test_a_target_that_is_a_source_stays_the_root():
    steps = list(merge_by_fitness("T", list("TA"), [_pair("A", "T", 0.9), _pair("T", "A", 0.3)], None))
    assert steps[-1].groups[0].root == "T"
    _assert_true_poses(steps[-1].groups[0])


def test_a_lidar_without_any_registration_is_left():
    steps = list(merge_by_fitness("T", list("TAB"), [_pair("T", "A", 0.9)], _Overlaps({}).register_again))
    assert steps[-1].decision.groups == (("A", "T"), ("B",))
    assert steps[-1].decision.reason == "stopped: no pair is left that could be registered"
