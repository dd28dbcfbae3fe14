# SPDX-License-Identifier: Apache-2.0
"""Nodes that publish in one process, multilica at ros2:// in another."""

from __future__ import annotations

import json
import sys
import tomllib
from pathlib import Path

import pytest

from multilica_cli.exit_codes import ExitCode
from tests.cli.support import Invoke, assert_one_sentence, write_thinned_sample
from tests.ros2.processes import HERE, NEEDS_ROS2, environment, multilica, running

VEHICLE = HERE / "vehicle.py"
SCANS = 2


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scans of each LiDAR of the embedded sample, with few points, and its static transforms."""
    return write_thinned_sample(tmp_path_factory.mktemp("log") / "log.mcap", 4)


def poses(run: Path) -> object:
    return tomllib.loads((run / "calibration.toml").read_text(encoding="utf-8"))["lidars"]


@NEEDS_ROS2
@pytest.mark.slow
@pytest.mark.in_turn
def test_nodes_give_the_poses_of_their_bag(log: Path, invoke: Invoke) -> None:
    options = ("--frames", SCANS, "--workers", 1, "--prior", "tf", "--quiet")
    with running(VEHICLE, log, "once"):
        live = multilica(Path.cwd(), "calibrate", "ros2://", *options, "--timeout", 20)
    assert (live.code, live.err) == (ExitCode.DONE, "")
    assert invoke("calibrate", log, *options).code == ExitCode.DONE
    runs = Path("recordings/runs")
    assert poses(runs / "ros2") == poses(runs / "log")
    document = json.loads((runs / "ros2" / "result.json").read_text(encoding="utf-8"))
    assert document["input"]["source"] == "ros2://"
    assert all(lidar["prior"] for name, lidar in document["lidars"].items() if name != document["target"])


@pytest.mark.in_turn
@NEEDS_ROS2
@pytest.mark.slow
def test_lost_scans_cost_time_alone(log: Path, tmp_path: Path) -> None:
    with running(VEHICLE, log, "lossy"):
        seen = multilica(tmp_path, "inspect", "ros2://", "--frames", "4", "--timeout", "20", "--json")
    document = json.loads(seen.out)
    assert (seen.code, document["objection"], document["notes"]) == (ExitCode.DONE, "", [])
    assert {cloud["topic"]: cloud["frames_taken"] for cloud in document["clouds"]} == {
        f"/lidar/{name}/points": 4 for name in ("front", "left", "rear", "right")
    }
    assert document["others"] == [{"topic": "/tf_static", "message_type": "tf2_msgs/msg/TFMessage", "count": None}]
    assert {transform["child"] for transform in document["static_transforms"]} == {"front", "left", "rear", "right"}


@pytest.mark.in_turn
@NEEDS_ROS2
@pytest.mark.slow
def test_a_publisher_that_dies_ends_at_the_limit(log: Path, tmp_path: Path) -> None:
    with running(VEHICLE, log, "dying"):
        options = ("--topic", "roof=/lidar/left/points", "--topic", "/lidar/*/points", "--timeout", "9")
        taken = multilica(tmp_path, "record", "ros2://", "--out", "a.mcap", *options)
    assert taken.code == ExitCode.DONE, taken
    assert "roof" in taken.out
    assert taken.out.count("of 10 scans, then the time limit of 9 s is over.") == 4


@NEEDS_ROS2
@pytest.mark.slow
def test_nobody_in_the_domain_is_one_sentence(tmp_path: Path) -> None:
    domain = environment()["ROS_DOMAIN_ID"]
    outcome = multilica(tmp_path, "record", "ros2://", "--timeout", "0.5", "--out", "a.mcap", "-q")
    assert_one_sentence(outcome, ExitCode.INPUT)
    assert f"No node publishes in the ROS 2 domain {domain} within 0.5 s" in outcome.err


@NEEDS_ROS2
def test_a_wrong_domain_is_one_sentence(tmp_path: Path) -> None:
    outcome = multilica(tmp_path, "record", "ros2://", "--out", "a.mcap", "-q", ROS_DOMAIN_ID="front")
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert "check ROS_DOMAIN_ID" in outcome.err


@pytest.mark.parametrize("command", ["inspect", "calibrate", "record"])
def test_without_a_client_both_ways_are_told(
    command: str,
    invoke: Invoke,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    options = {"inspect": ("--json",), "calibrate": ("-q", "--workers", "1"), "record": ("-q", "--out", "a.mcap")}
    outcome = invoke(command, "ros2://", *options[command])
    assert_one_sentence(outcome, ExitCode.BROKEN)
    assert "`pip install 'multilica[ros2]'` installs it, or source the setup file" in outcome.err


def test_the_address_has_no_name_of_a_host(invoke: Invoke) -> None:
    outcome = invoke("record", "ros2://robot", "--out", "a.mcap", "-q")
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert "ROS_DOMAIN_ID" in outcome.err


def test_it_is_given_alone(invoke: Invoke) -> None:
    Path("a.mcap").touch()
    outcome = invoke("calibrate", "ros2://", "a.mcap", "-q")
    assert_one_sentence(outcome, ExitCode.USAGE)
    assert "give it alone" in outcome.err
