# SPDX-License-Identifier: Apache-2.0
"""A LiDAR that two accepted pairs put at different places is shown at both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results import Verdict
from multilica.sinks.failures import failures
from multilica.sinks.report.contents import contents_of
from multilica.sinks.report.figures import pair_figures
from multilica.sinks.report.outcome import outcome_of
from multilica.sinks.rerun_recording import RerunRecording
from multilica.sinks.rerun_tree import pair_path
from multilica.sinks.rival_pose import rival_of
from multilica.sinks.run_story import RunStory
from tests.sinks.made_events import TRUTH, UNPLACED, made_events
from tests.sinks.recording_reader import Recording, blueprint_names

HALF_TURN = RigidTransform.from_xyz_rpy(UNPLACED, UNPLACED, (2.0, 0.0, 0.0), (0.0, 0.0, np.pi))
OTHER = "front left/1"


def told():
    """Both pairs of the unplaced LiDAR are accepted; that with `OTHER` has it turned around."""
    for event in made_events("partial"):
        match event:
            case events.PairRegistered(registration):
                yield events.PairRegistered(accepted(registration))
            case events.CalibrationFinished(result):
                yield events.CalibrationFinished(replace(result, pairs=tuple(map(accepted, result.pairs))))
            case _:
                yield event


def accepted(registration):
    names = (registration.target, registration.source)
    if UNPLACED not in names:
        return registration
    pose = registration.T_target_source
    if OTHER in names:
        pose = pose @ HALF_TURN if registration.source == UNPLACED else HALF_TURN.inverse() @ pose
    return replace(registration, T_target_source=pose, verdict=Verdict("accept"))


@pytest.fixture
def story() -> RunStory:
    story = RunStory()
    for event in told():
        story(event)
    return story


def test_the_failure_has_both_pairs(story):
    (failure,) = failures(story)
    assert (failure.lidar, failure.stage) == (UNPLACED, "merge")
    assert {frozenset(failure.pair), frozenset(failure.elsewhere)} == {
        frozenset((UNPLACED, "top")),
        frozenset((UNPLACED, OTHER)),
    }


def test_the_other_pose_is_where_the_other_pair_puts_it(story):
    (failure,) = failures(story)
    found = story.registrations[failure.pair]
    rival = rival_of(story, found)
    fixed = next(name for name in failure.pair if name != UNPLACED)
    puts = TRUTH[UNPLACED] @ HALF_TURN if fixed == "top" else TRUTH[UNPLACED]
    expected = TRUTH[fixed].inverse() @ puts if fixed != "top" else puts
    pose = rival.T_target_source if found.target == fixed else rival.T_target_source.inverse()
    assert pose.distance_to(expected) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert len(rival.probes_m) == len(rival.testimony.labels)
    (other,) = (one for pair, one in story.registrations.items() if pair == failure.elsewhere)
    assert rival_of(story, other) is None


def test_the_recording_opens_on_both_places(tmp_path, story):
    with RerunRecording(tmp_path / "recording.rrd") as observe:
        for event in told():
            observe(event)
    (failure,) = failures(story)
    recording = Recording(tmp_path / "recording.rrd")
    path = pair_path(*failure.pair)
    other = next(name for name in failure.elsewhere if name != UNPLACED)
    assert recording.last(f"{path}/verdict", "Points3D:labels")[0].endswith(f"accept, but {other} puts rear elsewhere")
    (label,) = recording.last(f"{path}/rival/label", "Points3D:labels")
    assert f"where {other} puts rear: " in label
    names = [name for names in blueprint_names(tmp_path / "recording.rrd") for name in names]
    assert any(name.endswith(", the other pose") for name in names)


def test_the_report_names_both_others_and_draws_both_places(story):
    contents = contents_of(story)
    (failure,) = outcome_of(contents).failures
    assert failure.missing.step.startswith("merge")
    assert set(failure.against) == {"top", OTHER}
    level = RigidTransform.identity("level", contents.target)
    figures = pair_figures(contents, failure.pair, level, dict.fromkeys(contents.names, (200, 100, 50)))
    assert ["where this pair puts it" in figures[0].caption, "where another accepted pair" in figures[1].caption] == [
        True,
        True,
    ]
