# SPDX-License-Identifier: Apache-2.0
"""A signal in the middle of a run leaves its recording, and no half-written other file."""

from __future__ import annotations

import importlib
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from multilica_cli.signals import Interrupted, received, unwind_on_signals
from tests.cli.support import command_of_process, environment_of_process
from tests.selection import some_of

STOPS = (signal.SIGINT, signal.SIGTERM)
DELAYS_S = (0.1, 0.2, 0.4, 0.7, 0.9, 1.1, 1.3)


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize(
    ("number", "stage"),
    some_of([(number, stage) for stage in ("preprocess", "fine") for number in (*STOPS, signal.SIGHUP)], 1),
)
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
def restored_handlers(monkeypatch: pytest.MonkeyPatch) -> object:
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGALRM)
    before = {number: signal.getsignal(number) for number in numbers}
    yield
    unwind_on_signals()  # forgets what was received
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


@pytest.mark.usefixtures("restored_handlers")
def test_a_signal_within_an_import_waits_for_its_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = ("import signal, time", "signal.raise_signal(signal.SIGTERM)", "time.sleep(0.1)", "loaded = True")
    (tmp_path / "slow_library.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(tmp_path)
    unwind_on_signals()
    with pytest.raises(Interrupted) as caught:
        _import_and_wait()
    assert caught.value.exit_code == 143
    assert sys.modules["slow_library"].loaded
    assert received().exit_code == 143


class _InterruptedAtItsEnd:
    def __del__(self) -> None:
        signal.raise_signal(signal.SIGTERM)


def _drop_and_wait() -> None:
    _InterruptedAtItsEnd()
    time.sleep(10.0)


@pytest.mark.usefixtures("restored_handlers")
def test_a_signal_within_the_end_of_an_object_is_not_lost() -> None:
    unwind_on_signals()
    with pytest.raises(Interrupted):
        _drop_and_wait()


def _import_and_wait() -> None:
    importlib.import_module("slow_library")
    time.sleep(10.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "delay_s"), some_of([(number, delay_s) for delay_s in DELAYS_S for number in STOPS], 2)
)
def test_a_signal_at_the_start_is_told_in_one_line(
    number: signal.Signals, delay_s: float, two_lidars: Path, tmp_path: Path
) -> None:
    arguments = ["multilica", "calibrate", str(two_lidars), "--out", str(tmp_path / "run"), "--quiet"]
    code = f"""
import os, sys, threading
sys.argv = {arguments!r}
from multilica_cli.__main__ import main
threading.Timer({delay_s}, os.kill, (os.getpid(), {int(number)})).start()
main()
"""
    ended = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=environment_of_process(), check=False
    )
    assert ended.returncode == 128 + number, ended.stderr
    assert ended.stderr.count("\n") == 1
    assert f"Stopped by {number.name}." in ended.stderr
