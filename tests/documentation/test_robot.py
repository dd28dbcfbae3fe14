# SPDX-License-Identifier: Apache-2.0
"""The files of the page on robots are ones that systemd and ROS 2 start."""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
from pathlib import Path

import pytest
import typer
from defusedxml import ElementTree

from multilica_cli.main import app
from tests.cli.support import ROOT

PAGE = ROOT / "docs" / "robot.md"
PROGRAM = "/opt/multilica/bin/multilica"


def block(language: str) -> str:
    """The only block of that language."""
    (found,) = re.findall(rf"^```{language}\n(.*?)^```", PAGE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    return found


def parsed(command: str) -> dict[str, object]:
    """The parameters of a command line of multilica, which is not run."""
    program, name, *arguments = shlex.split(command)
    assert program == PROGRAM
    return typer.main.get_command(app).commands[name].make_context(name, arguments).params


def test_the_launch_file_starts_commands_of_multilica() -> None:
    launch = ElementTree.fromstring(block("xml"))
    assert launch.tag == "launch"
    assert {child.tag for child in launch} == {"executable"}
    publish, watch = (parsed(child.attrib["cmd"]) for child in launch)
    assert (publish["to"], watch["source"]) == ("ros2://", "ros2://")
    assert publish["run"] == watch["calibration"]


def test_the_unit_starts_a_watch() -> None:
    (start,) = re.findall(r"^ExecStart=(.*)", block("ini"), re.MULTILINE)
    shell, option, script = shlex.split(start)
    source, _, command = script.partition(" && exec ")
    assert (shell, option, source) == ("/bin/bash", "-c", "source /opt/ros/jazzy/setup.bash")
    assert parsed(command)["source"] == "ros2://"


@pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="needs systemd-analyze, of systemd")
def test_systemd_takes_the_unit(tmp_path: Path) -> None:
    unit = tmp_path / "multilica-watch.service"
    unit.write_text(block("ini"), encoding="utf-8")
    seen = subprocess.run(["systemd-analyze", "verify", unit], capture_output=True, text=True, check=False)
    told = [line for line in seen.stderr.splitlines() if unit.name in line]
    assert (seen.returncode, told) == (0, [])
