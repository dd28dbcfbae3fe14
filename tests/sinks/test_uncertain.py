# SPDX-License-Identifier: Apache-2.0
"""An uncertain LiDAR is shown at its pose, marked, and apart from what programs read as the calibration."""

from __future__ import annotations

import json
import re
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from multilica import events, read_extrinsics
from multilica.ingest import read_prior
from multilica.sinks.files.result_files import ResultFiles
from multilica.sinks.mcap.result_mcap import ResultMcap
from multilica.sinks.report.page import report_html
from multilica.sinks.rerun.recording import RerunRecording
from multilica.sinks.run_state import RunState, failures
from multilica.sinks.text.log_lines import LogLine, log_lines
from multilica.sinks.text.markdown import decisions_markdown, summary_markdown
from tests.sinks.conftest import record
from tests.sinks.made_events import IMPRECISE, LIDARS, TARGET, TRUTH, UNPLACED, made_events
from tests.sinks.recording_reader import Recording, blueprint_names
from tests.sinks.report.conftest import made_contents

PLACED = {*LIDARS} - {UNPLACED}
LABEL = f"{UNPLACED}: uncertain (3 sigma x 10)"


@pytest.fixture(scope="module")
def state() -> RunState:
    state = RunState()
    for event in made_events("uncertain"):
        state(event)
    return state


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    directory = tmp_path_factory.mktemp("written")
    observe = ResultFiles(directory)
    for event in made_events("uncertain"):
        observe(event)
    return directory


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    return record(tmp_path_factory.mktemp("uncertain") / "run.rrd", "uncertain")


def test_result_json_has_status_pose_and_covariance(written):
    document = json.loads((written / "result.json").read_text())
    entry = document["lidars"][UNPLACED]
    assert document["status"] == "partial"
    assert (entry["placed"], entry["status"], entry["reason"]) == (False, "uncertain", IMPRECISE.text)
    np.testing.assert_array_equal(entry["T_target_source"], TRUTH[UNPLACED].matrix)
    assert entry["sigma_xyz_m"][0] == pytest.approx(IMPRECISE.value)
    assert entry["covariance"][3][3] == pytest.approx(IMPRECISE.value**2)
    assert {name: document["lidars"][name]["status"] for name in PLACED} == dict.fromkeys(PLACED, "placed")


def test_calibration_toml_has_it_in_a_table_of_its_own(written):
    table = tomllib.loads((written / "calibration.toml").read_text())
    assert set(table["lidars"]) == PLACED
    assert table["not_placed"] == {}
    (entry,) = table["uncertain"].values()
    assert {*table["lidars"]["front left/1"], "reason"} == {*entry}
    assert (entry["reason"], entry["sigma_xyz_m"][0]) == (IMPRECISE.text, pytest.approx(IMPRECISE.value))
    assert read_extrinsics(written / "calibration.toml").members == PLACED


def test_a_prior_takes_it_as_one_more_hypothesis(written, state):
    prior = read_prior(str(written / "calibration.toml"), state.snapshot)
    assert prior.notes == ()
    found = prior.extrinsics.between(TARGET, UNPLACED)
    np.testing.assert_allclose(found.matrix, TRUTH[UNPLACED].matrix, atol=1e-12)


def test_the_log_warns_with_the_reason():
    *_, last = made_events("uncertain")
    assert log_lines(last) == (
        LogLine("WARN", f"{UNPLACED} is uncertain: {IMPRECISE.text}"),
        LogLine("WARN", "calibration partial: 2 of 3 LiDARs placed, 1 uncertain"),
    )


def test_the_summary_has_pose_sigma_and_advice(state):
    text = summary_markdown(state)
    assert "# 1 of 3 LiDARs is uncertain. rear: one pose fits, but its sigma is above the limit." in text
    assert "| rear (**uncertain**) | -2.000 |" in text
    assert "| 30.0 |" in text
    assert "--max-sigma" in text
    assert "10 times enlarged" in text


def test_the_merge_that_joined_it_is_told(state):
    text = decisions_markdown(state.decisions, by_evidence=True)
    assert re.search(r"\| top <- rear \| 1 \| 9.5 \| 0.800 \| 0.060 \| merged, uncertain \|", text)


def test_nothing_counts_as_failed(state):
    assert failures(state) == ()


@pytest.mark.slow
def test_the_recording_shows_it_at_its_pose(recording):
    found = Recording(recording)
    assert found.last("/lidars/rear/sensor", "Transform3D:parent_frame") == ["lidar/top"]
    translation = found.last("/lidars/rear/sensor", "Transform3D:translation")[0]
    np.testing.assert_allclose(translation, TRUTH[UNPLACED].xyz_m, atol=1e-5)
    assert found.last("/lidars/rear/name/tip", "Points3D:labels") == [LABEL]
    sizes = found.last("/lidars/rear/uncertainty", "Ellipsoids3D:half_sizes")[0]
    assert max(sizes) == pytest.approx(IMPRECISE.value * 3.0 * 10.0, rel=1e-5)
    assert found.last("/lidars/front\\ left\\/1/name/tip", "Points3D:labels") == ["front left/1"]
    assert "Result" in blueprint_names(recording)[-1]
    assert not any(name.startswith("Not placed") for name in blueprint_names(recording)[-1])
    assert "Movable" not in blueprint_names(recording)[-1]


@pytest.mark.slow
def test_objects_that_hold_a_pose_have_a_tab(tmp_path):
    path = tmp_path / "held.rrd"
    with RerunRecording(path) as observe:
        for event in made_events("uncertain"):
            observe(_held(event) if isinstance(event, events.CalibrationFinished) else event)
    assert "Movable" in blueprint_names(path)[-1]
    assert len(Recording(path).last("/lidars/rear/movable", "Points3D:positions")) == 12


@pytest.mark.slow
@pytest.mark.parametrize("moved", [False, True])
def test_objects_that_moved_have_a_tab(tmp_path, moved):
    path = tmp_path / "moved.rrd"
    with RerunRecording(path) as observe:
        for event in made_events("uncertain"):
            observe(replace(event, moved=moved) if isinstance(event, events.MovableFound) else event)
    assert ("Movable" in blueprint_names(path)[-1]) == moved


def _held(finished):
    placements = (replace(each, held_by_movable=each.uncertain) for each in finished.result.placements)
    return events.CalibrationFinished(replace(finished.result, placements=tuple(placements)))


def test_the_frame_of_its_cloud_in_the_mcap_is_marked(tmp_path):
    path = tmp_path / "run.mcap"
    with ResultMcap(path, "ros2") as observe:
        for event in made_events("uncertain"):
            observe(event)
    with AnyReader([path]) as reader:
        messages = {one.topic: reader.deserialize(raw, one.msgtype) for one, _, raw in reader.messages()}
    frames = [each.child_frame_id for each in messages["/tf_static"].transforms]
    assert frames == ["top", "front left/1", "uncertain/rear"]
    assert messages["/lidar/rear/points"].header.frame_id == "uncertain/rear"
    assert messages["/lidar/top/points"].header.frame_id == "top"
    texts = {each.text for each in messages["/uncertainty"].markers if each.text}
    assert texts == {LABEL}
    assert "rear: uncertain" in {each.text for each in messages["/merge_graph"].markers}
    drawn = {each.header.frame_id for each in messages["/fields_of_view"].markers}
    assert drawn == {"front left/1", "uncertain/rear", "top"}
    metrics = json.loads(messages["/metrics"].data)
    assert (metrics["placed"], metrics["uncertain"]) == (2, 1)


def test_the_report_shows_status_pose_and_advice():
    contents = made_contents("uncertain")
    outcome = contents.explanation
    assert (contents.badge, outcome.missing) == ("partial", ())
    assert outcome.headline == "1 of 3 LiDARs is uncertain. rear: one pose fits, but its sigma is above the limit."
    page = report_html(contents)
    assert '<span class="status uncertain">UNCERTAIN</span>' in page
    assert "rear is uncertain: sigma 30.0 mm mostly along x of top, limit 20 mm." in page
    assert 'class="edge merged uncertain"' in page
    assert 'class="node uncertain"' in page
    assert "rear (uncertain)" in page
