# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from multilica import events
from multilica.run import CalibrationRun
from multilica.sinks.files.result_files import ResultFiles
from multilica.sinks.mcap.result_mcap import ResultMcap
from multilica.sinks.run_directory import open_run
from tests.sinks.numbers.made_numbers import numbered_events


@pytest.fixture(scope="session")
def numbered_run(tmp_path_factory: pytest.TempPathFactory) -> CalibrationRun:
    """With every file of a run."""
    directory = tmp_path_factory.mktemp("numbers") / "run"
    started, *_, finished = made = list(numbered_events())
    assert isinstance(finished, events.CalibrationFinished)
    with open_run(directory, started.config) as run:
        for event in made:
            run(event)
    return CalibrationRun(finished.result, started.config, directory, run.written)


@pytest.fixture(scope="session")
def numbered_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The directory of result.json and calibration.toml alone, which takes less time."""
    directory = tmp_path_factory.mktemp("files")
    observe = ResultFiles(directory)
    for event in numbered_events():
        observe(event)
    return directory


@pytest.fixture(scope="session")
def numbered_mcap(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Writes result.mcap alone in an encoding."""
    directory = tmp_path_factory.mktemp("mcap")

    def write(encoding: str) -> Path:
        with ResultMcap(directory / f"{encoding}.mcap", encoding) as observe:
            for event in numbered_events():
                observe(event)
        return directory / f"{encoding}.mcap"

    return write
