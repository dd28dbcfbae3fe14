# SPDX-License-Identifier: Apache-2.0
"""What rosbag2 asks of an MCAP file, and what ROS 2 itself makes of its messages."""

from __future__ import annotations

import json
import re
import subprocess
from pathlib import Path

import pytest
from mcap.reader import make_reader
from ruamel.yaml import YAML

from multilica.sinks.mcap.result_mcap import ResultMcap
from multilica.sinks.snapshots import write_snapshot_mcap
from tests.ingest.support.recording_writers import make_snapshot
from tests.sinks.made_drive import STOPS
from tests.sinks.made_events import LIDARS, made_events

ROS2_PYTHON = Path(__file__).parents[2] / "ros2" / ".venv" / "bin" / "python"
PRIMITIVES = re.compile(r"(bool|byte|char|float32|float64|u?int(8|16|32|64)|w?string)(<=\d+)?")
QOS_KEYS = {
    "history",
    "depth",
    "reliability",
    "durability",
    "deadline",
    "lifespan",
    "liveliness",
    "liveliness_lease_duration",
    "avoid_ros_namespace_conventions",
}
LATCHED = {"/tf_static", "/matches", "/merge_graph", "/fields_of_view", "/uncertainty", "/drive/stop_1"}
FOREVER = {"sec": 9223372036, "nsec": 854775807}


@pytest.fixture(scope="module")
def result(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("ros2") / "result.mcap"
    with ResultMcap(path, "ros2") as observe:
        for event in made_events(at_stops=True):
            observe(event)
    return path


@pytest.fixture(scope="module", params=["result", "snapshot"])
def summary_and_header(request, result, tmp_path_factory):
    path = result
    if request.param == "snapshot":
        path = tmp_path_factory.mktemp("ros2") / "snapshot.mcap"
        write_snapshot_mcap(make_snapshot(), path)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        return reader.get_summary(), reader.get_header()


def test_the_profile_is_ros2_and_messages_are_in_time_order(summary_and_header):
    summary, header = summary_and_header
    assert header.profile == "ros2"
    assert summary.statistics.message_count > 0
    assert all(index.message_index_length > 0 for index in summary.chunk_indexes)  # else "ros2 bag play" refuses it
    assert summary.statistics.message_end_time < 2**63


def test_messages_are_cdr_with_complete_definitions(summary_and_header):
    summary, _ = summary_and_header
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    for schema in summary.schemas.values():
        assert schema.encoding == "ros2msg"
        assert re.fullmatch(r"[a-z][a-z0-9_]*/msg/[A-Z]\w*", schema.name)
        assert undefined_in(schema.data.decode()) == set()


def undefined_in(definition: str) -> set[str]:
    """The types that a definition uses and neither defines nor has built in."""
    first, *others = re.split(r"\n=+\nMSG: ", definition)
    defined = {other.partition("\n")[0].strip().replace("/msg/", "/") for other in others}
    bodies = [first, *(other.partition("\n")[2] for other in others)]
    used = {line.split()[0].split("[")[0] for body in bodies for line in body.splitlines() if line.strip()}
    names = {name.split("/")[-1] for name in defined}
    complex_types = {name for name in used if not name.startswith("#") and not PRIMITIVES.fullmatch(name)}
    return {name for name in complex_types if name.replace("/msg/", "/") not in defined and name not in names}


def test_topics_have_names_that_ros2_allows(summary_and_header):
    summary, _ = summary_and_header
    for channel in summary.channels.values():
        assert re.fullmatch(r"(/[A-Za-z_][A-Za-z0-9_]*)+", channel.topic)


def test_each_topic_has_qos_that_every_rosbag2_reads(summary_and_header):
    # Humble reads numbers alone; Jazzy takes a profile for one of numbers if its history is one.
    summary, _ = summary_and_header
    for channel in summary.channels.values():
        (profile,) = YAML(typ="safe").load(channel.metadata["offered_qos_profiles"])
        assert set(profile) == QOS_KEYS
        assert all(type(profile[key]) is int for key in ("history", "depth", "reliability", "durability", "liveliness"))
        assert profile["deadline"] == profile["lifespan"] == profile["liveliness_lease_duration"] == FOREVER
        assert profile["durability"] == (1 if channel.topic in LATCHED else 2)


@pytest.mark.slow
@pytest.mark.skipif(not ROS2_PYTHON.exists(), reason="run: make ros2")
def test_ros2_itself_understands_every_message(result):
    command = [str(ROS2_PYTHON), str(Path(__file__).parent / "read_ros2.py"), str(result)]
    seen = json.loads(subprocess.run(command, capture_output=True, text=True, check=True, timeout=60).stdout)
    assert seen["/lidar/rear/points"] == [["rear", 600, 12, 7200]]
    assert {*LIDARS, "rear <- top"} <= set(seen["/merge_graph"][0])
    assert seen["/drive/stop_1"] == [["top", len(STOPS)]]
    assert any("calibration complete" in line for line in seen["/log"])
    assert json.loads(seen["/metrics"][0])["status"] == "complete"
    with result.open("rb") as file:
        topics = {channel.topic for channel in make_reader(file).get_summary().channels.values()}
    assert set(seen) == topics - {"/tf_static"}
