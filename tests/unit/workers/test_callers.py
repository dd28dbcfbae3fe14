# SPDX-License-Identifier: Apache-2.0
"""Processes that open workers: scripts without a guard of their main module, and processes that are killed."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
SCRIPT = """
from multilica.workers import open_workers
from tests.unit.workers.tasks import nap, processes, square
print("started", flush=True)
with open_workers(2) as workers:
    print(list(workers.map(square, [1, 2, 3])))
"""
LONG = (
    SCRIPT
    + """
    print(*sorted({process for found in workers.map(processes, range(10)) for process in found[:2]}), flush=True)
    list(workers.map(nap, [3600.0, 3600.0, 3600.0]))
"""
)


def environment():
    return {**os.environ, "PYTHONPATH": str(ROOT)}


@pytest.mark.parametrize("way", ["file", "argument", "input"])
def test_the_main_module_is_not_run_again(way, tmp_path):
    (tmp_path / "script.py").write_text(SCRIPT)
    arguments = {"file": ["script.py"], "argument": ["-c", SCRIPT], "input": ["-"]}[way]
    ended = subprocess.run(
        [sys.executable, *arguments],
        input=SCRIPT if way == "input" else "",
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env=environment(),
    )
    assert (ended.stdout, ended.stderr) == ("started\n[1, 4, 9]\n", "")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_process_outlives_its_caller(number):
    with subprocess.Popen(
        [sys.executable, "-c", LONG], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment()
    ) as caller:
        _, _, listed = (caller.stdout.readline() for _ in range(3))
        caller.send_signal(number)
        _, told = caller.communicate()
    assert ("Traceback" in told) == (number == signal.SIGINT)
    assert told.count("KeyboardInterrupt") == (number == signal.SIGINT)
    workers = [Path("/proc") / process for process in listed.split()]
    assert len(workers) == 3
    deadline_s = time.monotonic() + 60.0
    while any(is_alive(worker) for worker in workers):
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def is_alive(process):
    try:
        return (process / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False
