# SPDX-License-Identifier: Apache-2.0
"""A watch over nodes that die and start again, with a LiDAR that was knocked meanwhile."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
from datetime import UTC, datetime
from pathlib import Path
from urllib.request import urlopen

import pytest

from multilica import read_snapshot
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica_cli.commands.calibrate import find_sample
from tests.cli.support import write_thinned_sample
from tests.ros2.processes import HERE, NEEDS_ROS2, PYTHON, environment, running
from tests.watch.test_loop import KNOCK, moved


def next_line(watch: subprocess.Popen[str], outcome: str) -> str:
    """The next verdict of that kind."""
    return next(line for line in watch.stdout if f" {outcome}: " in line)


@pytest.mark.in_turn
@NEEDS_ROS2
@pytest.mark.slow
def test_a_knock_is_told_after_nodes_started_again(tmp_path: Path) -> None:
    log = write_thinned_sample(tmp_path / "log.mcap", 4)
    knocked = tmp_path / "knocked.mcap"
    write_snapshot_mcap(moved(read_snapshot(log), "left", KNOCK), knocked)
    with socket.create_server(("", 0)) as free:
        port = free.getsockname()[1]
    options = ("--interval", "1", "--frames", "2", "--timeout", "5", "--metrics", port, "--store", "store")
    command = [PYTHON, "-m", "multilica_cli", "watch", "ros2://", "--calibration", find_sample().truth, *options]
    with subprocess.Popen(
        [*map(str, command)], stdout=subprocess.PIPE, text=True, cwd=tmp_path, env=environment(PYTHONUNBUFFERED="1")
    ) as watch:
        try:
            with running(HERE / "vehicle.py", log, "lossy"):
                assert next_line(watch, "within").endswith("All 4 LiDARs agree with the reference.\n")
            began = datetime.now(UTC)
            with running(HERE / "vehicle.py", knocked, "lossy"):
                statuses = json.loads(
                    subprocess.run(
                        [PYTHON, HERE / "diagnostics.py", "outside"], capture_output=True, check=True, timeout=60,
                        env=environment(),
                    ).stdout
                )  # fmt: skip
                line = next_line(watch, "outside")
                with urlopen(f"http://127.0.0.1:{port}/metrics") as page:
                    metrics = page.read().decode()
            watch.send_signal(signal.SIGTERM)
            assert watch.wait(20) == 143
        finally:
            watch.kill()
    told, _, text = line.partition(" outside: ")
    assert abs((datetime.fromisoformat(told) - began).total_seconds()) < 60.0
    assert "left is outside" in text
    assert re.search(r'multilica_lidar_within\{lidar="left"\} 0\.0', metrics)
    assert statuses["multilica: left"] == 2
    for table in ("logs", "lidars"):
        assert len(list((tmp_path / "store" / table).rglob("*.parquet"))) >= 2
