# SPDX-License-Identifier: Apache-2.0
"""Registrations of searched pairs, and of pairs that others imply."""

from dataclasses import replace
from types import SimpleNamespace

from multilica.config import CalibrationConfig
from multilica.orchestration import search
from multilica.orchestration.pairs import PairSearch, register_implied, score_implied, search_pair
from multilica.orchestration.state import CalibrationState
from multilica.results import Verdict
from tests.unit.acceptance.made_rig import linked, scored, true_pose


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
    search._search_now(state, [("a", "b")], 0.3)
    assert state.registrations["a", "b"] is found
    search._register_implied(state, {("a", "b"): true_pose("a", "b")}, {("a", "b"): "a-c-b"})
    assert state.registrations["a", "b"] is looped
    assert state.searched["a", "b"] is found
