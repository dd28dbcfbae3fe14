# SPDX-License-Identifier: Apache-2.0
"""The vehicle's poses at the stops of a drive in result.mcap."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from multilica import events
from multilica.sinks.mcap.result_mcap import ResultMcap
from tests.sinks.made_drive import STOPS
from tests.sinks.made_events import TARGET, made_events

APART = tuple(replace(stop, first="a b") for stop in STOPS[1:])


def write(path: Path, encoding: str, stops=STOPS) -> Path:
    with ResultMcap(path, encoding) as observe:
        for event in made_events(at_stops=bool(stops)):
            if isinstance(event, events.CalibrationFinished):
                event = events.CalibrationFinished(replace(event.result, stops=stops))  # noqa: PLW2901
            observe(event)
    return path


def foxglove_poses(path: Path) -> dict[str, PosesInFrame]:
    with path.open("rb") as file:
        found = [*make_reader(file).iter_messages()]
    return {
        channel.topic: PosesInFrame.FromString(message.data)
        for schema, channel, message in found
        if schema.name == "foxglove.PosesInFrame"
    }


def ros2_poses(path: Path):
    with AnyReader([path]) as reader:
        connections = [one for one in reader.connections if one.msgtype == "geometry_msgs/msg/PoseArray"]
        return {one.topic: reader.deserialize(raw, one.msgtype) for one, _, raw in reader.messages(connections)}


def check(poses, stops):
    assert len(poses) == len(stops)
    for pose, stop in zip(poses, stops, strict=True):
        place, turn = pose.position, pose.orientation
        np.testing.assert_allclose((place.x, place.y, place.z), stop.T_first_stop.xyz_m)
        np.testing.assert_allclose((turn.x, turn.y, turn.z, turn.w), stop.T_first_stop.quaternion_xyzw)


def test_foxglove_has_the_poses_in_the_frame_of_the_target(tmp_path):
    poses = foxglove_poses(write(tmp_path / "run.mcap", "foxglove"))
    assert poses.keys() == {"/drive/stop_1"}
    assert poses["/drive/stop_1"].frame_id == TARGET
    check(poses["/drive/stop_1"].poses, STOPS)


def test_ros2_has_the_poses_in_the_frame_of_the_target(tmp_path):
    poses = ros2_poses(write(tmp_path / "run.mcap", "ros2"))
    assert poses.keys() == {"/drive/stop_1"}
    assert poses["/drive/stop_1"].header.frame_id == TARGET
    check(poses["/drive/stop_1"].poses, STOPS)


@pytest.mark.parametrize(
    ("encoding", "read", "name"), [("foxglove", foxglove_poses, "a b"), ("ros2", ros2_poses, "a_b")]
)
def test_stops_that_no_link_connects_have_topics_of_their_own(tmp_path, encoding, read, name):
    poses = read(write(tmp_path / "run.mcap", encoding, (STOPS[0], *APART)))
    assert poses.keys() == {"/drive/stop_1", f"/drive/{name}"}
    check(poses[f"/drive/{name}"].poses, APART)


def test_without_linked_stops_there_are_no_poses(tmp_path):
    assert foxglove_poses(write(tmp_path / "run.mcap", "foxglove", ())) == {}
