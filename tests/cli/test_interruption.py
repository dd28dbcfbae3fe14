# SPDX-License-Identifier: Apache-2.0
"""A signal in the middle of a run leaves its recording, and no half-written other file."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from multilica_cli.exit_codes import Interrupted, unwind_on_signals
from tests.cli.support import command_of_process, environment_of_process


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("stage", ["preprocess", "fine"])
def test_a_stopped_run_leaves_a_readable_recording(
    number: signal.Signals, stage: str, two_lidars: Path, tmp_path: Path
) -> None:
    out = tmp_path / "run"
    with subprocess.Popen(
        command_of_process("calibrate", two_lidars, "--out", out),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment_of_process(),
    ) as process:
        lines = iter(process.stderr.readline, "")
        assert any(line.startswith(stage) for line in lines), "the stage never finished"
        process.send_signal(number)
        printed, told = process.communicate(timeout=60)
    assert process.returncode == 128 + number, told
    last = told.splitlines()[-1]
    assert number.name in last
    assert str(out) in last
    assert "Traceback" not in told
    assert printed == ""
    left = {"config.toml", "recording.partial.rrd", "result.partial.mcap", "report.html"}
    assert {path.name for path in out.iterdir()} == left
    verify = [sys.executable, "-m", "rerun", "rrd", "verify", str(out / "recording.partial.rrd")]
    assert subprocess.run(verify, capture_output=True, check=False).returncode == 0


@pytest.fixture
def restored_handlers() -> object:
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("restored_handlers")
def test_a_second_signal_does_not_disturb_the_clean_up() -> None:
    unwind_on_signals()
    with pytest.raises(Interrupted) as caught:
        signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGTERM)
    assert caught.value.exit_code == 130


@pytest.mark.usefixtures("restored_handlers")
def test_signals_that_the_parent_ignores_stay_ignored() -> None:
    signal.signal(signal.SIGHUP, signal.SIG_IGN)
    unwind_on_signals()
    signal.raise_signal(signal.SIGHUP)
    assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
