# SPDX-License-Identifier: Apache-2.0
"""Where a LiDAR failed, against what."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from multilica import events
from multilica.errors import InputError
from multilica.explanation import explain
from multilica.results import PreprocessedCloud
from multilica.sinks.atomic import partial_path
from multilica.sinks.failures import Failure, decisive_failure, failures
from multilica.sinks.rerun_recording import RerunRecording
from multilica.sinks.run_document import run_document
from multilica.sinks.run_story import RunStory
from tests.sinks.made_events import UNPLACED, made_events
from tests.sinks.recording_reader import Recording


def story_of(told) -> RunStory:
    story = RunStory()
    for event in told:
        story(event)
    return story


def test_nothing_failed_where_all_are_placed_or_none_was_to_be():
    assert failures(story_of(made_events())) == ()
    assert failures(story_of(made_events("partial", until="fine"))) == ()


def test_a_refused_pair_is_the_one_that_the_explanation_calls_decisive():
    story = story_of(made_events("partial"))
    story.registrations = dict(reversed(story.registrations.items()))  # the first is no longer the decisive one
    (failure,) = failures(story)
    decisive = explain(run_document(story)).missing[0].decisive
    assert (failure.lidar, failure.stage) == (UNPLACED, "fine")
    assert failure.pair in story.matches
    assert set(failure.pair) == {decisive.target, decisive.source}


def test_matches_that_agree_on_nothing_fail_at_the_coarse_stage():
    found = {failure.lidar: failure for failure in failures(story_of(made_events("failed")))}
    assert (found[UNPLACED].stage, found["front left/1"].stage) == ("coarse", "fine")
    assert decisive_failure(story_of(made_events("failed"))) == found["front left/1"]


def test_of_two_comparisons_the_one_that_is_told_first_is_shown(monkeypatch):
    """However near each came: beside it stands the explanation, from its beginning."""
    story = story_of(made_events("partial"))
    pairs = sorted(story.registrations, key=lambda pair: story.registrations[pair].evidence)
    told = [Failure("dead", "preprocess", None), *(Failure(pair[1], "fine", pair) for pair in pairs)]
    monkeypatch.setattr("multilica.sinks.failures.failures", lambda _: tuple(told))
    assert len(pairs) > 1
    assert decisive_failure(story) == told[1]


def test_a_lidar_that_is_left_with_nothing_fails_at_preprocessing():
    nothing = np.empty((0, 3))
    empty = events.CloudPreprocessed(PreprocessedCloud(UNPLACED, nothing, nothing, {"too_near": np.ones((1200, 3))}))
    told = [
        empty if isinstance(event, events.CloudPreprocessed) and event.cloud.lidar == UNPLACED else event
        for event in made_events("partial")
    ]
    assert failures(story_of(told)) == (Failure(UNPLACED, "preprocess", None),)


def test_a_dead_lidar_fails_at_preprocessing():
    first, *rest = made_events("partial")
    lidars = tuple(
        dataclasses.replace(lidar, scans=()) if lidar.name == UNPLACED else lidar for lidar in first.snapshot.lidars
    )
    dead = dataclasses.replace(first, snapshot=dataclasses.replace(first.snapshot, lidars=lidars))
    assert failures(story_of([dead, *rest])) == (Failure(UNPLACED, "preprocess", None),)


def test_nothing_is_shown_of_a_pair_that_the_recording_does_not_hold():
    """A joint result has the pairs of its snapshots, which have recordings of their own."""
    alone = [event for event in made_events("partial") if not isinstance(event, events.PairRegistered)]
    (failure,) = failures(story_of(alone))
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
