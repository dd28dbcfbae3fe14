# SPDX-License-Identifier: Apache-2.0
"""Where a LiDAR failed, against what."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from multilica import events
from multilica.diagnosis import explain
from multilica.errors import InputError
from multilica.results import PreprocessedCloud
from multilica.sinks.files.atomic import partial_path
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.run_state import Failure, RunState, decisive_failure, failures
from tests.sinks.made_events import UNPLACED, made_events
from tests.sinks.recording_reader import Recording


def state_of(happened) -> RunState:
    state = RunState()
    for event in happened:
        state(event)
    return state


def test_nothing_failed_where_all_are_placed_or_none_was_to_be():
    assert failures(state_of(made_events())) == ()
    assert failures(state_of(made_events("partial", until="fine"))) == ()


def test_the_refused_pair_is_the_decisive_one():
    state = state_of(made_events("partial"))
    state.registrations = dict(reversed(state.registrations.items()))  # the first is no longer the decisive one
    (failure,) = failures(state)
    decisive = explain(state.document).missing[0].decisive
    assert (failure.lidar, failure.stage) == (UNPLACED, "fine")
    assert failure.pair in state.matches
    assert set(failure.pair) == {decisive.target, decisive.source}


def test_matches_without_a_hypothesis_fail_at_stage_coarse():
    found = {failure.lidar: failure for failure in failures(state_of(made_events("failed")))}
    assert (found[UNPLACED].stage, found["front left/1"].stage) == ("coarse", "fine")
    assert decisive_failure(state_of(made_events("failed"))) == found["front left/1"]


def test_of_two_pairs_the_first_of_the_explanation_is_shown(monkeypatch):
    """The view then shows the pair that the explanation lists first."""
    state = state_of(made_events("partial"))
    pairs = sorted(state.registrations, key=lambda pair: state.registrations[pair].evidence)
    listed = [Failure("dead", "preprocess", None), *(Failure(pair[1], "fine", pair) for pair in pairs)]
    monkeypatch.setattr("multilica.sinks.run_state.failures", lambda _: tuple(listed))
    assert len(pairs) > 1
    assert decisive_failure(state) == listed[1]


def test_a_lidar_without_kept_points_fails_at_preprocessing():
    nothing = np.empty((0, 3))
    empty = events.CloudPreprocessed(PreprocessedCloud(UNPLACED, nothing, nothing, {"too_near": np.ones((1200, 3))}))
    listed = [
        empty if isinstance(event, events.CloudPreprocessed) and event.cloud.lidar == UNPLACED else event
        for event in made_events("partial")
    ]
    assert failures(state_of(listed)) == (Failure(UNPLACED, "preprocess", None),)


def test_a_dead_lidar_fails_at_preprocessing():
    first, *rest = made_events("partial")
    lidars = tuple(
        dataclasses.replace(lidar, scans=()) if lidar.name == UNPLACED else lidar for lidar in first.snapshot.lidars
    )
    dead = dataclasses.replace(first, snapshot=dataclasses.replace(first.snapshot, lidars=lidars))
    assert failures(state_of([dead, *rest])) == (Failure(UNPLACED, "preprocess", None),)


def test_a_pair_outside_the_recording_is_not_shown():
    """A joint result has the pairs of its snapshots, which have recordings of their own."""
    alone = [
        event
        for event in made_events("partial")
        if not isinstance(event, events.PairRegistered | events.VerdictChanged)
    ]
    (failure,) = failures(state_of(alone))
    assert failure.pair is None


def test_what_ended_a_run_early_is_named_in_the_summary(tmp_path):
    def broken() -> None:
        with RerunRecording(tmp_path / "run.rrd") as observe:
            for event in list(made_events())[:4]:
                observe(event)
            raise InputError("drive.mcap ends in the middle of a message.")

    with pytest.raises(InputError):
        broken()
    summary = Recording(partial_path(tmp_path / "run.rrd")).last("/summary", "TextDocument:text")[0]
    assert "The run ended early: **drive.mcap ends in the middle of a message.**" in summary
