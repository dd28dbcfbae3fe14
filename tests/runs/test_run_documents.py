# SPDX-License-Identifier: Apache-2.0
"""The document of a run, from whatever is left of it."""

from __future__ import annotations

import json

import pytest

from multilica.config import CalibrationConfig
from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.results.document import parse_result
from multilica.runs.run_documents import read_run_document
from multilica.sinks.run_directory import open_run
from tests.sinks.made_documents import made_document
from tests.sinks.made_events import made_events


@pytest.fixture
def stopped(tmp_path):
    """A run that was stopped after some stages."""
    with open_run(tmp_path / "rig", CalibrationConfig(target="top")) as run:
        for event in list(made_events())[:26]:
            run(event)
    return tmp_path / "rig"


@pytest.mark.slow
def test_recording_and_mcap_of_a_stopped_run_tell_the_same(stopped):
    whole, recorded, attached = (
        read_run_document(path).document
        for path in (stopped, stopped / "recording.partial.rrd", stopped / "result.partial.mcap")
    )
    assert whole == recorded
    assert attached.progress == recorded.progress
    assert attached.pairs == recorded.pairs


@pytest.mark.slow
def test_where_the_recording_was_only_begun_the_mcap_tells(stopped):
    (stopped / "recording.partial.rrd").write_bytes(b"RRF2")
    run = read_run_document(stopped)
    assert run.document.status == "unfinished"
    assert run.document.progress.finished


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        ({"lidars": {}}, "`pairs` names"),
        ({"schema": "other/1"}, "has schema 'other/1'; expected 'multilica/result/1'"),
        ({"status": "fine"}, "is not a whole result: status"),
        ({"news": 1}, "is not a whole result: news"),
    ],
)
def test_damaged_document_is_refused_in_one_sentence(damage, words):
    values = made_document("partial") | damage
    with pytest.raises(UnreadableSourceError, match=words) as refusal:
        parse_result("run/result.json", json.dumps(values))
    assert str(refusal.value).startswith("run/result.json ")
    assert "\n" not in str(refusal.value)


def test_unknown_contested_pair_is_refused():
    values = made_document("partial")
    pair = ("top", "nobody")
    contested = {"pair": pair, "other": pair, "distance_m": 1.0, "angle_deg": 0.0}
    values["lidars"]["rear"]["contested"] = contested
    with pytest.raises(UnreadableSourceError, match="`contested` of a LiDAR names a pair"):
        parse_result("result.json", json.dumps(values))


@pytest.mark.slow
def test_where_nothing_can_be_read_the_recording_is_named(stopped):
    for name in ("recording.partial.rrd", "result.partial.mcap"):
        (stopped / name).write_bytes(b"junk")
    with pytest.raises(UnreadableSourceError, match=r"result\.partial\.mcap|recording\.partial\.rrd"):
        read_run_document(stopped)


def test_killed_joint_run_names_the_runs_of_its_snapshots(stopped):
    with pytest.raises(SourceNotFoundError, match="below it are the runs rig"):
        read_run_document(stopped.parent)
    (stopped.parent / "empty").mkdir()
    with pytest.raises(SourceNotFoundError, match=r"`multilica calibrate --out` leaves\.$"):
        read_run_document(stopped.parent / "empty")
