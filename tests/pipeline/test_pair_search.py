# SPDX-License-Identifier: Apache-2.0
"""Pairs are searched until accepted pairs link all LiDARs; what they imply is tested instead."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from multilica import events
from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.orchestration import pairs as pair_steps
from multilica.orchestration import search
from multilica.orchestration.earlier_stops import EarlierStops
from multilica.pipeline import calibrate
from multilica.results import Reason, Verdict
from multilica.simulate import simulate_snapshot
from multilica.stages.coarse import find_hypotheses
from multilica.stages.pair_choice import LEAST_PRIORITY
from tests.pipeline.watched import assert_true, of, only, sides, watched

pytestmark = pytest.mark.slow

_PAIRS = {frozenset(pair) for pair in (("left", "right"), ("left", "top"), ("right", "top"))}


@cache
def _half():
    return only(sides().snapshot, "left", "right", "top", every=2)


@cache
def _found():
    return watched(_half())


def _searched(seen):
    return [frozenset((each.coarse.target, each.coarse.source)) for each in of(events.HypothesesFound, seen)]


def _registered_as_loops(seen):
    return [each.registration.lidars for each in of(events.LoopRegistered, seen)]


def test_a_pair_that_others_link_is_registered_without_a_search():
    result, seen = _found()
    searched, loops = _searched(seen), _registered_as_loops(seen)
    assert len(searched) == 2
    assert {*searched, *loops} == _PAIRS
    assert {pair.lidars for pair in result.pairs} == _PAIRS
    assert len(result.refinement.pairs) == 3
    assert_true(result, sides().truth)


def _shifted(pose):
    shift = RigidTransform.from_xyz_rpy(pose.target, pose.target, (1.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    return shift @ pose


@pytest.mark.in_turn
def test_a_pair_whose_implied_pose_beams_contradict_is_searched(monkeypatch):
    def contradicted(lidars, pose):
        scored = pair_steps.score_implied(lidars, pose)
        return replace(scored, visibility=replace(scored.visibility, violate=100))

    monkeypatch.setattr(search, "score_implied", contradicted)
    _, seen = watched(_half(), "until=fine")
    assert {*_searched(seen)} == _PAIRS
    assert _registered_as_loops(seen) == []


@pytest.mark.in_turn
def test_a_pair_that_leaves_its_implied_pose_is_searched(monkeypatch):
    def carried_away(lidars, pose):
        found = pair_steps.register_implied(lidars, pose)
        return replace(found, T_target_source=_shifted(found.T_target_source))

    monkeypatch.setattr(search, "register_implied", carried_away)
    result, seen = watched(_half())
    assert _registered_as_loops(seen) == []
    assert {*_searched(seen)} == _PAIRS
    assert_true(result, sides().truth)


@pytest.mark.in_turn
def test_a_pose_that_an_earlier_stop_found_is_tested_first():
    result, seen = watched(_half(), earlier=EarlierStops.of([_found()[0]]))
    assert _searched(seen) == []
    assert {*_registered_as_loops(seen)} == _PAIRS
    assert_true(result, sides().truth)


@pytest.mark.in_turn
def test_a_wrong_pose_of_an_earlier_stop_is_searched():
    found, _ = _found()
    wrong = {(pair.target, pair.source): _shifted(pair.T_target_source) for pair in found.pairs}
    result, seen = watched(_half(), earlier=EarlierStops(wrong))
    assert len(_searched(seen)) == 2
    assert_true(result, sides().truth)


@pytest.mark.parametrize(("priority", "searched"), [(LEAST_PRIORITY - 1.0, 0), (LEAST_PRIORITY, 3)])
@pytest.mark.in_turn
def test_a_vain_pair_needs_promise_at_later_stops(priority, searched, monkeypatch):
    monkeypatch.setattr(search, "priority_of", lambda *_: priority)
    monkeypatch.setattr(pair_steps, "accept", lambda *_: Verdict("reject", (Reason("low_evidence", 0.0, 1.0, "made"),)))
    _, seen = watched(_half(), "until=fine", earlier=EarlierStops(vain=[tuple(sorted(pair)) for pair in _PAIRS]))
    assert len(_searched(seen)) == searched


@pytest.mark.in_turn
def test_without_links_all_pairs_are_searched(monkeypatch):
    monkeypatch.setattr(pair_steps, "accept", lambda *_: Verdict("undecided", (Reason("ambiguous", 0.0, 1.0, "made"),)))
    result, seen = watched(_half(), "features.retry_voxel_sizes_m=[]")
    assert sorted(map(sorted, _searched(seen))) == sorted(map(sorted, _PAIRS))
    assert result.status == "failed"


@pytest.mark.in_turn
@pytest.mark.parametrize("until", ["correspond", "coarse", "verify"])
def test_before_the_fine_stage_all_pairs_are_searched(until):
    _, seen = watched(only(sides().snapshot, "left", "right", "top", every=5), f"until={until}")
    assert len(of(events.CorrespondencesMatched, seen)) == 3
    assert len(_searched(seen)) == (0 if until == "correspond" else 3)
    assert len(of(events.HypothesesVerified, seen)) == (3 if until == "verify" else 0)
    assert of(events.PairRegistered, seen) == []


@pytest.mark.in_turn
def test_a_pair_that_the_search_missed_is_registered_as_a_loop(monkeypatch):
    def without_left_and_top(matches, *rest):
        found = find_hypotheses(matches, *rest)
        missed = {matches.target, matches.source} == {"left", "top"}
        return replace(found, hypotheses=()) if missed else found

    monkeypatch.setattr(pair_steps, "find_hypotheses", without_left_and_top)
    result, seen = watched(_half())
    assert frozenset(("left", "top")) in _registered_as_loops(seen)
    assert len(result.refinement.pairs) == 3
    assert_true(result, sides().truth)


@pytest.mark.parametrize("further", [False, True])
@pytest.mark.in_turn
def test_unconnected_lidars_are_searched_again(monkeypatch, further):
    calls = []

    def without_right_at_first(matches, *rest):
        calls.append((matches.target, matches.source))
        found = find_hypotheses(matches, *rest)
        missed = "right" in calls[-1] and len(calls) <= 3
        return replace(found, hypotheses=()) if missed else found

    monkeypatch.setattr(pair_steps, "find_hypotheses", without_right_at_first)
    result, seen = watched(_half(), f"features.retry_voxel_sizes_m={[0.3] if further else []}")
    assert {frozenset(pair) for pair in calls[:3]} == _PAIRS
    widened = of(events.SearchWidened, seen)
    if not further:
        assert widened == []
        assert not result["right"].placed
        return
    assert [each.voxel_size_m for each in widened] == [0.3]
    assert [*widened[0].pairs] == calls[3:]
    assert all("right" in pair for pair in calls[3:])
    assert_true(result, sides().truth)


@pytest.mark.in_turn
@pytest.mark.parametrize(("outcome", "searched"), [("undecided", False), ("uncertain", False), ("reject", True)])
def test_only_a_rejected_pair_is_searched_again(monkeypatch, outcome, searched):
    verdict = Verdict(outcome, (Reason("made", 0.0, 1.0, "made"),))
    monkeypatch.setattr(pair_steps, "accept", lambda *_: verdict)
    snapshot = only(sides().snapshot, "left", "top", every=5)
    result, seen = watched(snapshot, "until=fine")
    assert bool(of(events.SearchWidened, seen)) == searched
    _, seen = watched(snapshot, "until=fine", earlier=EarlierStops.of([result]))
    assert of(events.SearchWidened, seen) == []


@pytest.mark.in_turn
def test_a_doubted_pair_is_not_searched_again(monkeypatch):
    doubtful = Verdict("undecided", (Reason("ambiguous", 0.0, 1.0, "made"),))

    def doubt(pairs, *_):
        return [replace(pair, verdict=doubtful) if pair.verdict.accepted else pair for pair in pairs]

    monkeypatch.setattr(search, "check_scene_symmetry", doubt)
    result, seen = watched(only(sides().snapshot, "left", "top", every=2), "until=fine")
    assert [pair.verdict for pair in result.pairs] == [doubtful]
    assert len(of(events.VerdictChanged, seen)) == 1
    assert of(events.SearchWidened, seen) == []


@pytest.mark.in_turn
@pytest.mark.parametrize(("code", "placed"), [("not_observable", True), ("ambiguous", False)])
def test_an_accepted_pair_constrains_the_registration_of_groups(monkeypatch, code, placed):
    accept = pair_steps.accept
    doubt = Verdict("undecided", (Reason(code, 0.0, 1.0, "made"),))

    def doubtful_in_groups(registrations, *limits):
        return doubt if registrations[0].hypothesis == -1 else accept(registrations, *limits)

    monkeypatch.setattr(pair_steps, "accept", doubtful_in_groups)
    settings = "acceptance.min_well_constrained_eigenvalue=1e6", "merge.mode=algorithm1"
    result, _ = watched(_half(), *settings)
    assert (result.status == "complete") is placed
    if placed:
        assert_true(result, sides().truth)


@pytest.mark.in_turn
def test_merged_groups_count_as_pairs_of_their_members():
    """`right` is accepted against no single LiDAR here, but against two of them together."""
    snapshot = simulate_snapshot("chain", "street", 33, build_seed=33).snapshot
    result, _ = watched(snapshot, "target=front_left")
    assert result["right"].T_target_source is not None
    assert {"front_right", "right"} in [pair.lidars for pair in result.trusted]
    assert all(pair.bias_information is not None for pair in result.trusted)


@pytest.mark.in_turn
def test_a_pose_with_a_sigma_above_the_limit_is_uncertain():
    strict, _ = watched(_half(), "acceptance.max_sigma_m=0.0004")
    assert strict.status == "partial"
    others = [place for place in strict.placements if place.lidar != strict.target]
    assert [place.status for place in others] == ["uncertain", "uncertain"]
    assert all("limit 0.4 mm" in place.reason for place in others)
    assert all(place.covariance is not None for place in others)
    assert_true(strict, sides().truth)
    lenient, _ = _found()
    assert lenient.status == "complete"
    assert [place.status for place in lenient.placements] == ["placed"] * 3


@pytest.mark.in_turn
def test_six_spinning_lidars_that_see_everything_are_placed():
    simulation = simulate_snapshot("ring6", "street", 12, frames=1, sensors="ideal")
    result, seen = watched(only(simulation.snapshot, *simulation.snapshot.names, every=2))
    assert result.status == "complete"
    assert_true(result, simulation.truth)
    assert len(_searched(seen)) < 8
    assert len(result.pairs) > 8


def test_two_workers_give_the_same_bits_as_one():
    runs = [_found()[0], calibrate(_half(), CalibrationConfig(runtime={"workers": 2}))]
    for one, other in zip(*(run.pairs for run in runs), strict=True):
        assert (one.target, one.source) == (other.target, other.source)
        assert one.T_target_source.matrix.tobytes() == other.T_target_source.matrix.tobytes()
        assert one.information.tobytes() == other.information.tobytes()
        assert one.evidence == other.evidence
    for one, other in zip(*(run.placements for run in runs), strict=True):
        assert (one.lidar, one.status, one.reason) == (other.lidar, other.status, other.reason)
        assert one.T_target_source.matrix.tobytes() == other.T_target_source.matrix.tobytes()
        assert np.array_equal(one.sigma_xyz_m, other.sigma_xyz_m) or one.lidar == runs[0].target
