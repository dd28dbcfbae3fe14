# SPDX-License-Identifier: Apache-2.0
"""Tabs that are open first."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import rerun.blueprint as rrb

from multilica import events
from multilica.sinks.rerun.blueprint import stage_tab
from multilica.sinks.rerun.tables import matrix_bounds
from multilica.sinks.run_state import RunState
from tests.sinks.made_events import LIDARS, made_events
from tests.sinks.recording_reader import Recording

VIEW_PX = np.array([1278, 269])
LONGEST_WORD_PX = np.array([76, 24])  # "undecided"
PAIR_STAGES = ("correspond", "coarse", "fine")


def state_after(outcome: str, change=lambda event: event) -> RunState:
    state = RunState()
    for event in made_events(outcome):
        state(change(event))
    return state


def pairs_tab(state: RunState, stage: str) -> rrb.Container:
    tab = stage_tab(state, stage)
    return next(part for part in tab.contents if part.name == "Before and after") if stage == "fine" else tab


def opened(state: RunState, stage: str) -> rrb.Container:
    tab = pairs_tab(state, stage)
    return tab.contents[tab.active_tab]


def weaker(pair: tuple[str, str], event: events.Event) -> events.Event:
    """Take evidence from one pair: fewer of its points agree."""
    if not isinstance(event, events.PairRegistered) or {*pair} != {
        event.registration.target,
        event.registration.source,
    }:
        return event
    first, *others = event.registration.registrations
    less = replace(first, visibility=replace(first.visibility, agree=first.visibility.agree // 3))
    return events.PairRegistered(replace(event.registration, registrations=(less, *others)))


@pytest.mark.parametrize("stage", PAIR_STAGES)
@pytest.mark.parametrize("pair", [("front left/1", "rear"), ("front left/1", "top"), ("rear", "top")])
def test_the_accepted_pair_with_the_least_evidence_is_open(stage, pair):
    state = state_after("complete", partial(weaker, pair))
    assert opened(state, stage).name == " <- ".join(pair)


@pytest.mark.parametrize("stage", PAIR_STAGES)
def test_the_decisive_pair_of_an_unplaced_lidar_is_open(stage):
    state = state_after("partial", partial(weaker, ("front left/1", "top")))
    assert opened(state, stage).name == "rear <- top"


@pytest.mark.parametrize("stage", PAIR_STAGES)
def test_an_uncertain_pair_comes_before_accepted_ones(stage):
    state = state_after("uncertain", partial(weaker, ("front left/1", "top")))
    assert "rear" in opened(state, stage).name


def test_the_decisive_pair_has_a_tab_among_many_pairs(monkeypatch):
    monkeypatch.setattr("multilica.sinks.rerun.blueprint._MAX_PAIR_TABS", 1)
    assert [tab.name for tab in pairs_tab(state_after("partial"), "correspond").contents] == ["rear <- top"]


def test_kept_matches_are_shown_first_with_counts():
    kept, everything = opened(state_after("partial"), "correspond").contents
    assert (kept.name, everything.name) == (
        "rear <- top: 20 of 80 matches kept (green)",
        "rear <- top: 20 kept (green), 60 rejected (red)",
    )
    rejected = "- /pairs/rear/top/matches/rejected"
    assert (rejected in kept.contents, rejected in everything.contents) == (True, False)


def test_without_a_hypothesis_the_rejected_matches_are_shown():
    tabs = {tab.name: tab for tab in pairs_tab(state_after("failed"), "correspond").contents}
    (everything,) = tabs["rear <- top"].contents
    assert everything.name == "rear <- top: 0 kept (green), 80 rejected (red)"


def test_a_pair_without_a_hypothesis_has_no_view_before_gicp():
    state = state_after("complete")
    with_hypothesis, *_ = pairs_tab(state, "fine").contents
    assert [view.name for view in with_hypothesis.contents] == ["Before GICP", "After GICP"]
    pair = next(iter(state.registrations))
    state.registrations[pair] = replace(state.registrations[pair], hypothesis=-1)
    implied, *_ = pairs_tab(state, "fine").contents
    assert [view.name for view in implied.contents] == ["After GICP, which started from the implied pose"]


def test_matrices_lie_within_their_view(recordings):
    recording = Recording(recordings["complete"])
    upper_left, lower_right = matrix_bounds(len(LIDARS))
    for path in ("/fitness", "/coverage", "/verdicts"):
        places = np.array(recording.last(f"{path}/labels", "Points2D:positions"))
        (size,) = recording.last(f"{path}/picture", "Image:format")
        assert np.all(places > upper_left)
        assert np.all(places < lower_right)
        assert np.all(np.array([size["width"], size["height"]]) <= lower_right)


@pytest.mark.parametrize("lidars", [4, 8])
def test_words_fit_into_the_cells_at_1280_by_720(lidars):
    upper_left, lower_right = matrix_bounds(lidars)
    scale = min(VIEW_PX / (lower_right - upper_left))
    assert np.all(scale * lower_right / lidars > LONGEST_WORD_PX)
