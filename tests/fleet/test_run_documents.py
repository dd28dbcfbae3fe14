# SPDX-License-Identifier: Apache-2.0
"""The document of a run, from whatever is left of it."""

from __future__ import annotations

import pytest

from multilica.config import CalibrationConfig
from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.fleet.run_documents import read_run_document
from multilica.sinks.run_directory import open_run
from tests.sinks.made_events import made_events


@pytest.fixture
def stopped(tmp_path):
    """A run that was stopped after some stages."""
    with open_run(tmp_path / "rig", CalibrationConfig(target="top")) as run:
        for event in list(made_events())[:26]:
            run(event)
    return tmp_path / "rig"


def test_recording_and_mcap_of_a_stopped_run_tell_the_same(stopped):
    whole, recorded, attached = (
        read_run_document(path).document
        for path in (stopped, stopped / "recording.partial.rrd", stopped / "result.partial.mcap")
    )
    assert whole == recorded
    assert attached["progress"] == recorded["progress"]
    assert attached["pairs"] == recorded["pairs"]


def test_where_the_recording_was_only_begun_the_mcap_tells(stopped):
    (stopped / "recording.partial.rrd").write_bytes(b"RRF2")
    run = read_run_document(stopped)
    assert run.document["status"] == "unfinished"
    assert run.document["progress"]["finished"]


def test_where_nothing_can_be_read_the_recording_is_named(stopped):
    for name in ("recording.partial.rrd", "result.partial.mcap"):
        (stopped / name).write_bytes(b"junk")
    with pytest.raises(UnreadableSourceError, match=r"result\.partial\.mcap|recording\.partial\.rrd"):
        read_run_document(stopped)


def test_a_joint_run_that_was_killed_names_the_runs_of_its_snapshots(stopped):
    with pytest.raises(SourceNotFoundError, match="below it are the runs rig"):
        read_run_document(stopped.parent)
    (stopped.parent / "empty").mkdir()
    with pytest.raises(SourceNotFoundError, match=r"`multilica calibrate --out` leaves\.$"):
        read_run_document(stopped.parent / "empty")
