# SPDX-License-Identifier: Apache-2.0
"""result.json and calibration.toml."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from defusedxml import ElementTree

from multilica import events, read_extrinsics
from multilica.config import STAGES
from multilica.errors import UnreadableSourceError
from multilica.extrinsics import Extrinsics
from multilica.results.building import collect_versions, provenance_of, result_document
from multilica.results.document import parse_result
from multilica.sinks.files.result_files import ResultFiles, matrix_text, toml_text, urdf_text
from multilica.sinks.run_state import RunState
from tests.sinks.made_events import LIDARS, TARGET, TRUTH, UNPLACED, made_events

ROOT = Path(__file__).resolve().parents[3]
SCHEMA = json.loads((ROOT / "docs" / "reference" / "result.schema.json").read_text(encoding="utf-8"))


def refuse_constant(name: str) -> None:
    raise AssertionError(f"{name} is not JSON")


@pytest.fixture
def written(tmp_path, request):
    outcome, until = getattr(request, "param", ("complete", "ground"))
    observe = ResultFiles(tmp_path)
    for event in made_events(outcome, until):
        observe(event)
    return tmp_path


@pytest.mark.parametrize(
    ("written", "status"),
    [
        (("complete", "ground"), "complete"),
        (("partial", "ground"), "partial"),
        (("failed", "ground"), "failed"),
        (("complete", "coarse"), "failed"),
    ],
    indirect=["written"],
)
def test_result_json_follows_its_schema_in_strict_json(written, status):
    text = (written / "result.json").read_text(encoding="utf-8")
    document = json.loads(text, parse_constant=refuse_constant)
    jsonschema.validate(document, SCHEMA)
    assert document["status"] == status
    assert list(document["stages"]) == document["progress"]["finished"]
    assert set(document["lidars"]) == set(LIDARS)
    np.testing.assert_array_equal(document["lidars"][TARGET]["T_target_source"], np.eye(4))


def test_result_json_is_read_back_as_it_was_written(written):
    text = (written / "result.json").read_text(encoding="utf-8")
    document = parse_result("result.json", text)
    assert f"{document.model_dump_json(indent=2)}\n" == text


def test_a_document_of_another_schema_is_refused_by_name(written):
    text = (written / "result.json").read_text(encoding="utf-8")
    with pytest.raises(UnreadableSourceError, match="has schema 'other/1'; expected 'multilica/result/1'"):
        parse_result("result.json", text.replace("multilica/result/1", "other/1"))


def test_poses_in_result_json_are_exact(written):
    document = json.loads((written / "result.json").read_text())
    for name, pose in TRUTH.items():
        np.testing.assert_array_equal(document["lidars"][name]["T_target_source"], pose.matrix)
        np.testing.assert_array_equal(document["lidars"][name]["rpy_deg"], pose.rpy_deg)


@pytest.mark.parametrize("written", [("partial", "ground")], indirect=True)
def test_what_is_not_known_is_null(written):
    document = json.loads((written / "result.json").read_text())
    refused = document["lidars"][UNPLACED]
    assert refused["placed"] is False
    assert refused["T_target_source"] is None
    assert refused["rmse_m"] is None
    assert "fitness 0.100" in refused["reason"]
    assert document["timing_s"]["broken"] is None


def document_after(last):
    """The document when the first event of a type has been told."""
    state = RunState()
    for event in made_events():
        state(event)
        if isinstance(event, last):
            break
    return state.document


@pytest.mark.slow
@pytest.mark.parametrize(
    ("last", "finished", "running"),
    [
        (events.CalibrationStarted, (), None),
        (events.StageStarted, (), "ingest"),
        (events.StageFinished, ("ingest",), None),
        (events.CalibrationFinished, STAGES, None),
    ],
)
def test_the_document_tells_how_far_the_run_is(last, finished, running):
    document = document_after(last)
    assert (document.progress.finished, document.progress.running) == (tuple(finished), running)
    assert document.status == ("complete" if finished == STAGES else "unfinished")
    assert document.target == TARGET


def test_the_document_is_pure():
    first, *_, last = made_events()
    provenance = provenance_of(first.snapshot)
    once = result_document(last.result, first.config, provenance)
    assert once == result_document(last.result, first.config, provenance)
    expected = {"topic": "/top", "frame_id": "top_frame", "frames": 2, "points": 1200}
    assert once.input.lidars[TARGET].model_dump() == expected


def test_calibration_toml_gives_the_same_extrinsics(written):
    extrinsics = read_extrinsics(written / "calibration.toml")
    assert extrinsics.target == TARGET
    for name, pose in TRUTH.items():
        np.testing.assert_allclose(extrinsics.T_target_source[name].matrix, pose.matrix, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("written", [("partial", "ground")], indirect=True)
def test_calibration_toml_names_what_is_not_placed_and_why(written):
    table = tomllib.loads((written / "calibration.toml").read_text())
    assert table["status"] == "partial"
    assert set(table["lidars"]) == set(LIDARS) - {UNPLACED}
    assert table["not_placed"] == {UNPLACED: "its best registration has fitness 0.100, below 0.2"}
    assert table["lidars"]["front left/1"]["fitness"] == 0.8
    assert table["input"]["sha256"].startswith("c0ffee")
    assert table["versions"]["multilica"] == collect_versions()["multilica"]


def test_calibration_toml_spells_out_units_and_frames(written):
    comments = [line for line in (written / "calibration.toml").read_text().splitlines() if line.startswith("#")]
    text = " ".join(comments)
    for word in ("metres", "degrees", "extrinsic xyz", '"top"', "p_target = T_target_source @ p_source", "w last"):
        assert word in text


def test_nothing_is_written_before_the_end(tmp_path):
    observe = ResultFiles(tmp_path)
    for event in list(made_events())[:-1]:
        observe(event)
    assert list(tmp_path.iterdir()) == []


def test_versions_are_those_of_what_is_installed():
    versions = collect_versions()
    assert {"multilica", "python", "numpy", "scipy", "open3d", "rerun", "mcap"} <= set(versions)
    assert versions["numpy"] == np.__version__
    assert all(re.match(r"\d", version) for version in versions.values())


def test_toml_rows_of_numbers_stand_on_one_line():
    document = {"row": [1.5, -2e-9, 3], "matrix": [[1.0, 0.0], [0.0, 1.0]], "words": ["a", "[1, 2]"], "none": []}
    text = toml_text(document)
    assert "row = [1.5, -2e-09, 3]" in text
    assert tomllib.loads(text) == document


def test_a_urdf_has_a_joint_per_frame():
    robot = ElementTree.fromstring(urdf_text(Extrinsics(TARGET, TRUTH)))
    names = sorted({*TRUTH} - {TARGET})
    assert [link.get("name") for link in robot.iter("link")] == [TARGET, *names]
    joints = [
        (joint.get("name"), joint.find("parent").get("link"), joint.find("child").get("link"))
        for joint in robot.iter("joint")
    ]
    assert joints == [(f"{name}_joint", TARGET, name) for name in names]


def test_matrices_stand_below_the_names_of_their_frames():
    lines = matrix_text(Extrinsics(TARGET, TRUTH)).splitlines()[1:]
    names = sorted({*TRUTH} - {TARGET})
    assert lines[::5] == [f"# T_target_source {TARGET} {'rear' if name == 'rear' else repr(name)}" for name in names]
    for index, name in enumerate(names):
        rows = [[float(number) for number in line.split()] for line in lines[5 * index + 1 : 5 * index + 5]]
        np.testing.assert_allclose(rows, TRUTH[name].matrix, atol=1e-12)
