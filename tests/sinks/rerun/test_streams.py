# SPDX-License-Identifier: Apache-2.0
"""Runs in one process leave no threads and files behind."""

from __future__ import annotations

from pathlib import Path

import pytest

from multilica.config import CalibrationConfig
from multilica.sinks.run_directory import open_run
from tests.sinks.made_events import made_events


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
