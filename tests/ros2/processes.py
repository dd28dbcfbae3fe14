# SPDX-License-Identifier: Apache-2.0
"""Processes of a Python that has rclpy, in a ROS 2 domain of their own."""

from __future__ import annotations

import os
import subprocess
import sysconfig
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.cli.support import Outcome

HERE = Path(__file__).parent
PYTHON = HERE / ".venv" / "bin" / "python"
ROOT = HERE.parents[1]
NEEDS_ROS2 = pytest.mark.skipif(not PYTHON.exists(), reason="run: make ros2")


def environment(**more: str) -> dict[str, str]:
    """The packages of this environment come before those of the wheels, which are the same ones or none."""
    paths = (ROOT, ROOT / "cli", sysconfig.get_path("purelib"))
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(str, paths)),
        "OMP_NUM_THREADS": "1",
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        **more,
    }


def multilica(folder: Path, *arguments: object, **variables: str) -> Outcome:
    """Run a command line in a folder."""
    command = [PYTHON, "-m", "multilica_cli", *map(str, arguments)]
    ended = subprocess.run(
        command, capture_output=True, text=True, timeout=120, cwd=folder, env=environment(**variables), check=False
    )
    return Outcome(ended.returncode, ended.stdout, ended.stderr)


@contextmanager
def running(*command: object, folder: Path = ROOT) -> Iterator[subprocess.Popen[str]]:
    """A process that has printed its first line."""
    with subprocess.Popen(
        [PYTHON, *map(str, command)], stdout=subprocess.PIPE, text=True, cwd=folder, env=environment()
    ) as process:
        try:
            process.stdout.readline()
            yield process
        finally:
            process.kill()
