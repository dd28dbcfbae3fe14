# SPDX-License-Identifier: Apache-2.0
"""A run that is killed leaves what it had."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

from multilica.diagnosis import explain
from multilica.runs.run_documents import read_run_document
from tests.sinks.recording_reader import Recording, blueprint_names

ROOT = Path(__file__).resolve().parents[3]
# Two of them leave Python no time, so a push takes one of these.
SIGNALS = [signal.SIGKILL, pytest.param(signal.SIGTERM, marks=pytest.mark.nightly), signal.SIGINT]


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("signal_number", SIGNALS, ids=lambda number: number.name)
def test_finished_stages_of_a_killed_run_can_be_read(tmp_path, signal_number, rerun_rrd):
    command = [sys.executable, str(Path(__file__).parent / "killed_run.py"), str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment, text=True
    ) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "reached\n"
        process.send_signal(signal_number)
        assert process.wait(timeout=30) != 0
    told_at_the_end = {"report.html"} if signal_number == signal.SIGINT else set()  # the others leave Python no time
    left = {"config.toml", "recording.partial.rrd", "result.partial.mcap"}
    assert {path.name for path in tmp_path.iterdir()} == left | told_at_the_end
    recording = Recording(tmp_path / "recording.partial.rrd")
    finished = [text for _, _, text in recording.log if text.endswith(" finished")]
    assert finished[-1] == "stage features finished"
    assert "/pairs/front\\ left\\/1/top/scored/violations" in recording.entity_paths
    assert "/pairs/rear/top" not in "".join(recording.entity_paths)
    assert "/lidars/top/raw" in recording.entity_paths
    assert any("Preprocess" in names for names in blueprint_names(tmp_path / "recording.partial.rrd"))
    assert "cut off after stage features" in recording.last("/summary", "TextDocument:text")[0]
    told = explain(read_run_document(tmp_path).document)
    assert told.cause == "unfinished"
    assert "cut off after stage features" in told.headline
    of_pairs = signal_number == signal.SIGINT
    assert told.known[0].startswith("rear <- front left/1: accept" if of_pairs else "front left/1: ")
    assert explain(read_run_document(tmp_path / "result.partial.mcap").document) == told
    held = messages_of(tmp_path / "result.partial.mcap")
    assert {"/lidar/top/points", "/log"} <= set(held)
    assert b"stage features finished" in b"".join(held["/log"])
    if signal_number == signal.SIGINT:
        assert b"the run ended early: KeyboardInterrupt" in held["/log"][-1]
        assert recording.properties()["status"] == "interrupted"
        assert rerun_rrd("verify", tmp_path / "recording.partial.rrd").returncode == 0


def messages_of(mcap: Path) -> dict[str, list[bytes]]:
    found: dict[str, list[bytes]] = {}
    with mcap.open("rb") as file:
        for _, channel, message in make_reader(file, validate_crcs=True).iter_messages():
            found.setdefault(channel.topic, []).append(message.data)
    return found
