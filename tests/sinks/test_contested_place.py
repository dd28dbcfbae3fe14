# SPDX-License-Identifier: Apache-2.0
"""A LiDAR that two accepted pairs put at different places is shown at both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multilica import events
from multilica.acceptance.placement import contested_place
from multilica.geometry import RigidTransform
from multilica.results import Verdict
from multilica.sinks.report.contents import contents_of
from multilica.sinks.report.figures import pair_figures
from multilica.sinks.report.page import opponents
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.rerun.scene import pair_path
from multilica.sinks.run_state import RunState, failures
from tests.sinks.made_events import TRUTH, UNPLACED, made_events
from tests.sinks.recording_reader import Recording, blueprint_names

HALF_TURN = RigidTransform.from_xyz_rpy(UNPLACED, UNPLACED, (2.0, 0.0, 0.0), (0.0, 0.0, np.pi))
OTHER = "front left/1"


def contested_events():
    """Both pairs of the unplaced LiDAR are accepted; that with `OTHER` has it turned around."""
    for event in made_events("partial"):
        match event:
            case events.VerdictChanged():
                pass
            case events.PairRegistered(registration):
                yield events.PairRegistered(accepted(registration))
            case events.CalibrationFinished(result):
                yield events.CalibrationFinished(contested(replace(result, pairs=tuple(map(accepted, result.pairs)))))
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


def contested(result):
    poses = {place.lidar: place.T_target_source for place in result.placements if place.placed}
    score = result.pairs[0].registrations[0]
    place = contested_place(UNPLACED, poses, result.pairs, lambda pose: replace(score, T_target_source=pose))
    placements = tuple(replace(one, contested=None if one.placed else place) for one in result.placements)
    return replace(result, placements=placements)


@pytest.fixture
def state() -> RunState:
    state = RunState()
    for event in contested_events():
        state(event)
    return state


def test_the_failure_has_both_pairs(state):
    (failure,) = failures(state)
    assert (failure.lidar, failure.stage) == (UNPLACED, "merge")
    assert {frozenset(failure.pair), frozenset(failure.elsewhere)} == {
        frozenset((UNPLACED, "top")),
        frozenset((UNPLACED, OTHER)),
    }


def test_the_other_pose_is_where_the_other_pair_puts_it(state):
    (failure,) = failures(state)
    found = state.registrations[failure.pair]
    competing_pose = state.competing(failure.pair)
    fixed = next(name for name in failure.pair if name != UNPLACED)
    puts = TRUTH[UNPLACED] @ HALF_TURN if fixed == "top" else TRUTH[UNPLACED]
    expected = TRUTH[fixed].inverse() @ puts if fixed != "top" else puts
    pose = competing_pose.T_target_source if found.target == fixed else competing_pose.T_target_source.inverse()
    assert pose.distance_to(expected) == pytest.approx((0.0, 0.0), abs=1e-6)
    assert len(competing_pose.probes_m) == len(competing_pose.visibility.labels)
    assert state.competing(failure.elsewhere) is None


def test_result_json_tells_how_far_the_places_are_apart(state):
    contested = state.document.lidars[UNPLACED].contested
    assert {*contested.pair, *contested.other} == {"top", OTHER, UNPLACED}
    assert (contested.distance_m, contested.angle_deg) == pytest.approx((2.0, 180.0))


def test_the_recording_opens_on_both_places(tmp_path, state):
    with RerunRecording(tmp_path / "recording.rrd") as observe:
        for event in contested_events():
            observe(event)
    (failure,) = failures(state)
    recording = Recording(tmp_path / "recording.rrd")
    path = pair_path(*failure.pair)
    other = next(name for name in failure.elsewhere if name != UNPLACED)
    assert recording.last(f"{path}/verdict", "Points3D:labels")[0].endswith(f"accept, but {other} puts rear elsewhere")
    (label,) = recording.last(f"{path}/competing/label", "Points3D:labels")
    assert f"where {other} puts rear: " in label
    names = [name for names in blueprint_names(tmp_path / "recording.rrd") for name in names]
    assert any(name.endswith(", competing pose: green agrees there as well") for name in names)


def test_the_report_names_both_others_and_draws_both_places(state):
    contents = contents_of(state)
    (failure,) = contents.explanation.missing
    assert failure.step.startswith("merge")
    assert set(opponents(failure)) == {"top", OTHER}
    figures = pair_figures(contents, failure.decisive.key)
    assert [
        "at the pose of this pair" in figures[0].caption,
        "another accepted pair implies" in figures[1].caption,
    ] == [
        True,
        True,
    ]
