# SPDX-License-Identifier: Apache-2.0
"""Neither commands nor tests leave anything in the folder for temporary files."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from multilica.sinks.rerun import viewer
from tests.cli.support import Invoke, command_of_process, environment_of_process
from tests.conftest import temporary_folder

LEAVE = "import sys, tempfile; tempfile.mkdtemp(); sys.exit()"


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "temporary"
    folder.mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@pytest.mark.in_turn
@pytest.mark.slow
def test_commands_leave_nothing(temporary: Path, two_lidars: Path, invoke: Invoke) -> None:
    command = command_of_process("calibrate", two_lidars, "--out", "run", "--workers", "2")
    ended = subprocess.run(command, env=environment_of_process(), capture_output=True, check=False)
    assert ended.returncode == 0, ended.stderr
    assert list(temporary.iterdir()) == []
    for words in (
        ("explain", "run"),
        ("report", "run", "--out", "page.html"),
        ("query", "run", "pairs"),
        ("verify", two_lidars, "--calibration", "run", "--summary", "check.md"),
    ):
        outcome = invoke(*words)
        assert outcome.code == 0, outcome
        assert list(temporary.iterdir()) == [], words


@pytest.mark.parametrize("show", ["window", "catalog"])
def test_processes_of_rerun_leave_nothing(show: str, temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer, "_COMMAND", (sys.executable, "-c", LEAVE))
    monkeypatch.setenv("DISPLAY", ":0")
    if show == "window":
        recording = temporary.with_name("recording.rrd")
        recording.touch()
        viewer.show_recording(recording)
    else:
        viewer.serve_catalog({}, "127.0.0.1", 0)
    assert list(temporary.iterdir()) == []


def test_what_tests_leave_goes_with_them() -> None:
    before = tempfile.gettempdir(), os.environ["TMPDIR"]
    assert Path(before[0]).name.startswith("multilica-tests-")  # of the session
    with temporary_folder() as folder:
        subprocess.run([sys.executable, "-c", LEAVE], check=True)
        assert len(list(Path(folder).iterdir())) == 1
        assert tempfile.gettempdir() == folder
    assert not Path(folder).exists()
    assert (tempfile.gettempdir(), os.environ["TMPDIR"]) == before
