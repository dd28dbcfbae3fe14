# SPDX-License-Identifier: Apache-2.0
"""Registrations of searched pairs, of pairs that others imply, and of groups."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from multilica.config import CalibrationConfig, with_overrides
from multilica.orchestration import refinement, rig, search
from multilica.orchestration.pairs import PairSearch, register_implied, score_implied, search_pair
from multilica.orchestration.state import CalibrationState
from multilica.results import Group, PairResidual, Verdict
from tests.unit.acceptance.made_rig import linked, registered, scored, true_pose
from tests.unit.made_pairs import pose


def test_what_a_search_found_outlives_a_loop():
    """Three poses that fit show a scene that repeats, also once others imply one of them."""
    found = replace(linked("a", "b"), verdict=Verdict("undecided"))
    looped = replace(linked("a", "b"), hypothesis=-1)
    results = {
        search_pair: PairSearch(matches=None, registration=found),
        score_implied: scored(true_pose("a", "b")),
        register_implied: looped,
    }
    workers = SimpleNamespace(map=lambda task, items: [results[task] for _ in items])
    state = CalibrationState(snapshot=None, config=CalibrationConfig(), observe=lambda _: None, workers=workers)
    search._search(state, [("a", "b")], 0.3)
    assert state.registrations["a", "b"] is found
    search._register_implied(state, {("a", "b"): true_pose("a", "b")}, {("a", "b"): "a-c-b"})
    assert state.registrations["a", "b"] is looped
    assert state.searched["a", "b"] is found


def test_a_search_again_knows_what_the_first_one_verified():
    """Also poses that were not registered to the end are refused."""
    verified = (scored(true_pose("a", "b")), scored(pose("a", "b", (3.0, 0.0, 0.0))))
    asked = []

    def searched(_, requests):
        asked.extend(requests)
        return [PairSearch(matches=None, coarse="found", verified=verified) for _ in requests]

    state = CalibrationState(
        snapshot=None, config=CalibrationConfig(), observe=lambda _: None, workers=SimpleNamespace(map=searched)
    )
    for voxel_size_m in (0.3, 0.5):
        search._search(state, [("a", "b")], voxel_size_m)
    assert [each.refused for each in asked] == [None, tuple(each.T_target_source for each in verified)]


def test_the_chain_that_implied_a_pair_is_remembered(monkeypatch):
    results = {score_implied: scored(true_pose("a", "c")), register_implied: replace(linked("a", "c"), hypothesis=-1)}
    workers = SimpleNamespace(map=lambda task, items: [results[task] for _ in items])
    state = CalibrationState(snapshot=None, config=CalibrationConfig(), observe=lambda _: None, workers=workers)
    state.clouds = dict.fromkeys("abc")
    state.registrations = {("a", "b"): linked("a", "b"), ("b", "c"): linked("b", "c")}
    monkeypatch.setattr(search, "_check_pairs", lambda _: False)
    search._close_loops(state, set())
    assert state.registrations["a", "c"].hypothesis == -1
    assert state.implied_by == {("a", "c"): [frozenset("ab"), frozenset("bc")]}


def test_contradicted_pairs_are_searched_whatever_the_time(monkeypatch):
    asked = []
    state = CalibrationState(
        snapshot=None,
        config=CalibrationConfig(),
        observe=lambda _: None,
        workers=SimpleNamespace(map=lambda _, requests: asked.extend(requests) or [None] * len(requests)),
        deadline_s=3.0,
    )
    monkeypatch.setattr(search, "_register_implied", lambda *_: {("a", "c")})
    monkeypatch.setattr(search, "_check_pairs", lambda _: False)
    search._close_loops(state, set())
    search._search(state, [("a", "b")], 0.3)
    assert [(each.pair, each.deadline_s) for each in asked] == [(("a", "c"), np.inf), (("a", "b"), 3.0)]


def test_a_merged_cloud_without_time_is_told(monkeypatch):
    state = CalibrationState(snapshot=None, config=CalibrationConfig(), observe=pytest.fail, deadline_s=3.0)
    state.merged_lidars[("a", "b")], state.lidars["c"] = "both", "alone"
    monkeypatch.setattr(rig, "search_pair", lambda _, request: None if request.deadline_s == 3.0 else "late")
    group = SimpleNamespace(members=("a", "b"), root="a")
    assert rig._search_merged(state, group, SimpleNamespace(root="c")) is None
    assert state.cut_short


def test_groups_without_a_pair_are_doubted_in_repeating_scenes(monkeypatch):
    merge, seen = linked("a", "d", 100), []
    state = CalibrationState(snapshot=None, config=CalibrationConfig(), observe=seen.append)
    monkeypatch.setattr(rig, "register_groups", lambda *_: merge)
    groups = Group.of_one("a"), Group.of_one("d")
    assert rig._register_groups(state, *groups, []) is merge
    state.searched = {("b", "c"): registered(true_pose("b", "c"), competing=[pose("b", "c", (7.0, 0.0, 0.0))])}
    found = rig._register_groups(state, *groups, [])
    assert found.verdict.codes == ("held_by_repetition",)
    assert seen[-1].registration is found


def test_pairs_that_the_mode_leaves_out_are_not_missed():
    """Without verification the mode tells which pairs are searched, each with its target first."""
    config = with_overrides(CalibrationConfig(), ["verify.enabled=false", "merge.mode=target_first", "target=m"])

    def searched(_, requests):
        assert {request.deadline_s for request in requests} == {9.0}
        return [PairSearch(matches=None, coarse="found"), *(None for _ in requests[1:])]

    workers = SimpleNamespace(map=searched)
    state = CalibrationState(snapshot=None, config=config, observe=lambda _: None, workers=workers, deadline_s=9.0)
    state.clouds = dict.fromkeys("amz")
    search.search_pairs(state)
    assert state.cut_short
    assert [*state.coarse] == [("m", "a")]
    assert state.not_reached == (("m", "z"),)


@pytest.mark.parametrize("outcome", ["reject", "undecided"])
def test_only_pairs_that_join_are_doubted(outcome):
    """A member of a merge may have a registration of its own that counts for nothing."""
    state = CalibrationState(snapshot=None, config=CalibrationConfig(), observe=lambda _: None)
    own = replace(linked("a", "b"), verdict=Verdict(outcome))
    state.registrations = {("a", "b"): own}
    state.merges = [(linked("a", "b"), linked("a", "c"))]
    refinement._doubt_pair(state, PairResidual("a", "b", 0.0, 0.0, 0.5, 1.0, 1.0, probability=1e-9))
    assert state.registrations["a", "b"] is own
    assert [[pair.lidars for pair in merge] for merge in state.merges] == [[{*"ac"}]]
