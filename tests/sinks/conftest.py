# SPDX-License-Identifier: Apache-2.0
"""Made-up runs, recorded once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from multilica.sinks.rerun.recording import RerunRecording
from tests.sinks.made_events import made_events


def record(path: Path, *args, **kwargs) -> Path:
    with RerunRecording(path) as observe:
        for event in made_events(*args, **kwargs):
            observe(event)
    return path


@pytest.fixture(scope="session")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A recording per outcome, and one of a drive."""
    directory = tmp_path_factory.mktemp("recordings")
    made = {outcome: record(directory / f"{outcome}.rrd", outcome) for outcome in ("complete", "partial", "failed")}
    return made | {"drive": record(directory / "drive.rrd", at_stops=True)}


@pytest.fixture(scope="session")
def rerun_rrd():
    """Runs ``rerun rrd ...``."""

    # The binary counts its runs unless CI is set.
    environment = {**os.environ, "CI": "1"}

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "rerun", "rrd", *map(str, arguments)]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=60, env=environment)

    return run
