# SPDX-License-Identifier: Apache-2.0
"""Runs in one process leave no threads and files behind."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from multilica.config import CalibrationConfig
from multilica.sinks.run_directory import open_run
from tests.sinks.made_events import made_events

_RECORD = """
import sys
from pathlib import Path
from multilica.sinks.rerun.recording import RerunRecording
from tests.sinks.made_events import made_events
with RerunRecording(Path(sys.argv[1]) / "run.rrd") as observe:
    for event in made_events():
        observe(event)
"""


def threads_and_files():
    return tuple(len(list(Path("/proc/self", kind).iterdir())) for kind in ("task", "fd"))


@pytest.mark.slow
@pytest.mark.in_turn
def test_runs_leave_no_threads_and_no_open_files(tmp_path):
    counted = []
    for number in range(4):
        with open_run(tmp_path / f"{number}", CalibrationConfig(target="top")) as run:
            for event in made_events():
                run(event)
        counted.append(threads_and_files())
    assert counted[1:] == counted[1:2] * 3


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_recording_that_cannot_be_written_ends_the_run(tmp_path):
    """Rerun waits forever for a writer that has ended, at its shutdown too."""
    ended = subprocess.run(
        [sys.executable, "-c", _RECORD, str(tmp_path)],
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000)),
        capture_output=True,
        text=True,
        check=False,
        timeout=100.0,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert ended.returncode == 1
    assert ended.stderr.rstrip().endswith(f"OSError: [Errno 5] Input/output error: '{tmp_path}/run.partial.rrd'")
