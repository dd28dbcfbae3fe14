# SPDX-License-Identifier: Apache-2.0
"""A ROS 2 that is sourced, as on a robot: in another folder than the environment of multilica."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from multilica.errors import MissingDependencyError
from multilica.ros2.client import require_client
from tests.cli.support import write_thinned_sample
from tests.ros2.processes import HERE, NEEDS_ROS2, PYTHON, ROOT, environment, running

OWN = f"{sys.version_info.major}.{sys.version_info.minor}"
OF_SYSTEM = ("yaml", "_yaml")
"""Packages that ROS 2 takes from the system, of those that multilica does not need."""


def sourced(prefix: Path) -> dict[str, str]:
    """The variables that a setup file sets for the packages of the wheels, linked into a folder like /opt/ros."""
    wheels = PYTHON.parents[1]
    packages, libraries = wheels / "lib" / f"python{OWN}" / "site-packages", [wheels / "lib"]
    site = prefix / "lib" / f"python{OWN}" / "site-packages"
    site.mkdir(parents=True)
    of_ros = [path.name for path in (wheels / "share/ament_index/resource_index/packages").iterdir()]
    for name in (*of_ros, *OF_SYSTEM):
        if (packages / name).exists():
            (site / name).symlink_to(packages / name)
    libraries += packages.glob("ros_*.libs")
    return {
        "AMENT_PREFIX_PATH": str(wheels),
        "LD_LIBRARY_PATH": os.pathsep.join(map(str, libraries)),
        "PYTHONPATH": os.pathsep.join(map(str, (ROOT, ROOT / "cli", site))),
    }


@pytest.mark.in_turn
@NEEDS_ROS2
@pytest.mark.slow
def test_a_service_needs_a_sourced_ros_2_alone(tmp_path: Path) -> None:
    log = write_thinned_sample(tmp_path / "log.mcap", 8)
    variables = environment(**sourced(tmp_path / "opt"))
    for missing in ("HOME", "ROS_HOME", "ROS_LOG_DIR"):
        variables.pop(missing, None)
    command = [sys.executable, "-m", "multilica_cli", "inspect", "ros2://", "--frames", "2", "--timeout", "20"]
    with running(HERE / "vehicle.py", log, "lossy"):
        seen = subprocess.run(
            command, capture_output=True, text=True, timeout=60, cwd=tmp_path, env=variables, check=False
        )
    assert (seen.returncode, seen.stderr) == (0, "listening for 2 scans of each LiDAR, at most 20 s\n")
    assert "calibrate would use: front (2 of 2 frames), left" in seen.stdout


OWN_TOPIC = """
from multilica.ros2 import Ros2Node
node = Ros2Node("A test")
node.publisher("/diagnostics", "std_msgs/msg/String", latched=False)
while not node.offer("/diagnostics"):
    node.spin(0.1)
print(node.topics())
"""


@NEEDS_ROS2
@pytest.mark.slow
def test_a_node_does_not_hear_itself() -> None:
    command = [PYTHON, "-c", OWN_TOPIC]
    seen = subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment(), check=True)
    assert seen.stdout == "{}\n"


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """Put an rclpy of a Python version in front, which consists of one line."""
    for name in [name for name in sys.modules if name.partition(".")[0] == "rclpy"]:
        monkeypatch.delitem(sys.modules, name)

    def put(version: str, line: str) -> None:
        package = tmp_path / "humble" / "lib" / f"python{version}" / "site-packages" / "rclpy"
        package.mkdir(parents=True)
        (package / "__init__.py").write_text(f"{line}\n", encoding="utf-8")
        monkeypatch.syspath_prepend(package.parent)

    return put


def test_a_ros_2_of_another_python_is_named(source: Callable[[str, str], None], tmp_path: Path) -> None:
    source("3.10", "raise ImportError('The C extension cannot be found')")
    with pytest.raises(MissingDependencyError) as caught:
        require_client("Listening")
    said = f"Listening needs a ROS 2 for Python {OWN}; the sourced one at {tmp_path}/humble/lib is for Python 3.10. "
    assert str(caught.value).startswith(said)


def test_what_ros_2_takes_from_the_system_is_named(source: Callable[[str, str], None]) -> None:
    source(OWN, "raise ModuleNotFoundError(name='yaml')")
    with pytest.raises(MissingDependencyError, match=r"the library yaml, .* `pip install pyyaml` installs it"):
        require_client("Listening")


def test_a_broken_client_of_this_python_is_told(source: Callable[[str, str], None]) -> None:
    source(OWN, "raise ImportError('librcl.so: cannot open shared object file')")
    with pytest.raises(MissingDependencyError, match=r"cannot be loaded \(librcl\.so.*or source the setup file"):
        require_client("Listening")
