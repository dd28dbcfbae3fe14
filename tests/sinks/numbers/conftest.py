# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from pathlib import Path

import pytest

from multilica import events
from multilica.run import CalibrationRun
from multilica.sinks.run_directory import open_run
from tests.sinks.numbers.made_numbers import numbered_events


def _written(directory: Path, encoding: str) -> CalibrationRun:
    started, *_, finished = made = list(numbered_events())
    assert isinstance(finished, events.CalibrationFinished)
    with open_run(directory, started.config, encoding) as run:
        for event in made:
            run(event)
    return CalibrationRun(finished.result, started.config, directory, run.written)


@pytest.fixture(scope="session")
def numbered_run(tmp_path_factory: pytest.TempPathFactory) -> CalibrationRun:
    return _written(tmp_path_factory.mktemp("numbers") / "foxglove", "foxglove")


@pytest.fixture(scope="session")
def ros2_mcap(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return _written(tmp_path_factory.mktemp("numbers") / "ros2", "ros2").directory / "result.mcap"
