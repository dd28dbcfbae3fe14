# SPDX-License-Identifier: Apache-2.0
"""A watch over a Foxglove bridge that dies and starts again on its port, with a LiDAR that was knocked meanwhile."""

from __future__ import annotations

import re
import signal
import socket
import subprocess
import time
from pathlib import Path
from threading import Timer
from urllib.request import urlopen

import pytest

from multilica import read_snapshot
from multilica.geometry import RigidTransform
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica_cli.commands.calibrate import find_sample
from tests.cli.support import command_of_process, environment_of_process, write_thinned_sample
from tests.ingest.support.processes import served
from tests.watch.test_loop import moved

KNOCKS = {
    "left": RigidTransform.from_xyz_rpy("left", "left", (0.0, 0.05, 0.0), (0.0, 0.0, 0.0)),
    "rear": RigidTransform.from_xyz_rpy("rear", "rear", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0087)),
}
"""5 cm, and 0.5 degrees."""


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


def outside(port: int) -> list[str]:
    """The LiDARs that a scrape tells to be outside."""
    with urlopen(f"http://127.0.0.1:{port}/metrics") as page:
        return re.findall(r'multilica_lidar_within\{lidar="(\w+)"\} 0\.0', page.read().decode())


def soon(port: int, name: str) -> bool:
    """Whether the metrics tell what the line told before; its look goes on with them."""
    end_s = time.monotonic() + 5.0
    while outside(port) != [name] and time.monotonic() < end_s:
        time.sleep(0.05)
    return outside(port) == [name]


@pytest.mark.in_turn
@pytest.mark.slow
def test_a_knock_is_told_after_the_bridge_started_again(tmp_path: Path) -> None:
    log = write_thinned_sample(tmp_path / "log.mcap", 4)
    port, metrics = free_port(), free_port()
    options = ("--interval", "1", "--frames", "2", "--timeout", "3", "--metrics", metrics)
    source = ("watch", f"ws://127.0.0.1:{port}", "--calibration", find_sample().truth)
    with subprocess.Popen(
        command_of_process(*source, *map(str, options)), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        cwd=tmp_path, env={**environment_of_process(), "PYTHONUNBUFFERED": "", "OMP_NUM_THREADS": "1"},
    ) as watch:  # fmt: skip
        limit = Timer(100.0, watch.kill)
        limit.start()
        try:
            with served("drive_server.py", port, log):
                assert watch.stdout.readline().endswith(" within: All 4 LiDARs agree with the reference.\n")
            assert f" failed: Nothing answers at ws://127.0.0.1:{port} within 3 s" in watch.stderr.readline()
            for name, knock in KNOCKS.items():
                knocked = tmp_path / f"{name}.mcap"
                write_snapshot_mcap(moved(read_snapshot(log), name, knock), knocked)
                with served("drive_server.py", port, knocked):
                    line = next(line for line in watch.stdout if " outside: " in line and f"{name} is" in line)
                    assert re.findall(r"(\w+): ", line.partition("outside: ")[2]) == [name]
                    assert soon(metrics, name)
            watch.send_signal(signal.SIGTERM)
            assert watch.wait(20) == 143
        finally:
            limit.cancel()
            watch.kill()
