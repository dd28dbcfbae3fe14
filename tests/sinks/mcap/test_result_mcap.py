# SPDX-License-Identifier: Apache-2.0
"""result.mcap, read back by readers of several makes."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tomllib
from collections import defaultdict
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rerun.chunk import McapReader
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

from multilica import events
from multilica.errors import UnknownNameError
from multilica.sinks.mcap.result_mcap import ResultMcap, _static_poses
from multilica.sinks.mcap.ros2_messages import Ros2Encoding
from tests.sinks.made_documents import made_document, parsed
from tests.sinks.made_events import LIDARS, TARGET, TRUTH, UNPLACED, made_events
from tests.sinks.made_scans import STAMP_NS

NODE_MODULES = Path(__file__).parents[2] / "node" / "node_modules"
HOW_TO_INSTALL = "npm install --prefix tests/node --no-package-lock"
FOXGLOVE_TOPICS = {
    "/tf": "foxglove.FrameTransforms",
    "/lidar/front left/1/points": "foxglove.PointCloud",
    "/lidar/rear/points": "foxglove.PointCloud",
    "/lidar/top/points": "foxglove.PointCloud",
    "/matches": "foxglove.SceneUpdate",
    "/merge_graph": "foxglove.SceneUpdate",
    "/fields_of_view": "foxglove.SceneUpdate",
    "/uncertainty": "foxglove.SceneUpdate",
    "/log": "foxglove.Log",
    "/metrics": "multilica.Metrics",
}
ROS2_TOPICS = {
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/lidar/front_left_1/points": "sensor_msgs/msg/PointCloud2",
    "/lidar/rear/points": "sensor_msgs/msg/PointCloud2",
    "/lidar/top/points": "sensor_msgs/msg/PointCloud2",
    "/matches": "visualization_msgs/msg/MarkerArray",
    "/merge_graph": "visualization_msgs/msg/MarkerArray",
    "/fields_of_view": "visualization_msgs/msg/MarkerArray",
    "/uncertainty": "visualization_msgs/msg/MarkerArray",
    "/log": "rcl_interfaces/msg/Log",
    "/metrics": "std_msgs/msg/String",
}


def write(path: Path, encoding: str, *args) -> Path:
    with ResultMcap(path, encoding) as observe:
        for event in made_events(*args):
            observe(event)
    return path


def write_until(path: Path, encoding: str, stage: str) -> Path:
    """Copy the files of a run after that stage."""
    with ResultMcap(path.with_name("running.mcap"), encoding) as observe:
        for event in made_events():
            observe(event)
            if isinstance(event, events.StageFinished) and event.stage == stage:
                shutil.copy(path.with_name("running.partial.mcap"), path)
    return path


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    directory = tmp_path_factory.mktemp("mcap")
    ended = {
        (encoding, outcome): write(directory / f"{encoding}-{outcome}.mcap", encoding, outcome)
        for encoding in ("foxglove", "ros2")
        for outcome in ("complete", "partial")
    }
    running = {
        (encoding, "running"): write_until(directory / f"{encoding}-running.mcap", encoding, "fine")
        for encoding in ("foxglove", "ros2")
    }
    return ended | running


def topics_of(path: Path) -> dict[str, str]:
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    return {channel.topic: summary.schemas[channel.schema_id].name for channel in summary.channels.values()}


def test_topics_and_schemas_have_their_exact_names(files):
    assert topics_of(files["foxglove", "complete"]) == FOXGLOVE_TOPICS
    assert topics_of(files["ros2", "complete"]) == ROS2_TOPICS


@pytest.mark.parametrize("encoding", ["foxglove", "ros2"])
def test_chunks_are_compressed_indexed_and_checked(files, encoding):
    with files[encoding, "complete"].open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == ("ros2" if encoding == "ros2" else "")
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
        assert all(chunk.message_index_offsets for chunk in summary.chunk_indexes)
        assert summary.statistics.message_count == len(list(reader.iter_messages()))
    data = bytearray(files[encoding, "complete"].read_bytes())
    data[summary.chunk_indexes[0].chunk_start_offset + 200] ^= 0xFF
    broken = files[encoding, "complete"].with_suffix(".broken.mcap")
    broken.write_bytes(data)
    with broken.open("rb") as file, pytest.raises(Exception, match=r"(?i)crc|decompress|corrupt|frame"):
        list(make_reader(file, validate_crcs=True).iter_messages())


@pytest.mark.parametrize("encoding", ["foxglove", "ros2"])
def test_config_result_and_identity_travel_with_the_file(files, encoding):
    with files[encoding, "partial"].open("rb") as file:
        reader = make_reader(file)
        attachments = {one.name: one for one in reader.iter_attachments()}
        metadata = {one.name: one.metadata for one in reader.iter_metadata()}
    assert tomllib.loads(attachments["config.toml"].data.decode())["target"] == TARGET
    result = json.loads(attachments["result.json"].data)
    assert result["schema"] == "multilica/result/1"
    assert result["lidars"][UNPLACED]["placed"] is False
    assert metadata["multilica"]["status"] == "partial"
    assert metadata["multilica"]["input_sha256"].startswith("c0ffee")
    assert metadata["multilica"]["version"]


@pytest.mark.parametrize("encoding", ["foxglove", "ros2"])
def test_transforms_come_no_later_than_what_they_place(files, encoding):
    with files[encoding, "complete"].open("rb") as file:
        messages = list(make_reader(file).iter_messages())
    first = defaultdict(list)
    for _, channel, message in messages:
        first[channel.topic].append(message.log_time)
    assert first["/tf_static" if encoding == "ros2" else "/tf"] == [STAMP_NS]
    assert all(min(times) >= STAMP_NS for times in first.values())
    assert messages[0][1].topic in ("/tf", "/tf_static")


@pytest.mark.parametrize("doubt", ["", "it is seen on one side only"])
def test_a_doubtful_base_is_no_transform(doubt):
    document = made_document()
    document["ground"]["doubt"] = doubt
    poses = _static_poses(parsed(document), dict.fromkeys(document["lidars"], "lidar"))
    assert ("base" in {pose.target for pose in poses}) == (not doubt)


def test_rosbags_reads_the_ros2_file(files):
    with AnyReader([files["ros2", "complete"]]) as reader:
        found = defaultdict(list)
        for connection, _, raw in reader.messages():
            found[connection.topic].append(reader.deserialize(raw, connection.msgtype))
        durability = {one.topic: one.ext.offered_qos_profiles[0].durability for one in reader.connections}
        depth = {one.topic: one.ext.offered_qos_profiles[0].depth for one in reader.connections}
    transforms = {one.child_frame_id: one for one in found["/tf_static"][0].transforms}
    assert {name: one.header.frame_id for name, one in transforms.items()} == {
        "front left/1": TARGET,
        "rear": TARGET,
        TARGET: "base",
    }
    rear = transforms["rear"].transform
    np.testing.assert_allclose([rear.translation.x, rear.translation.y, rear.translation.z], TRUTH["rear"].xyz_m)
    quaternion = [rear.rotation.x, rear.rotation.y, rear.rotation.z, rear.rotation.w]
    np.testing.assert_allclose(quaternion, TRUTH["rear"].quaternion_xyzw)
    cloud = found["/lidar/rear/points"][0]
    assert (cloud.header.frame_id, cloud.width, cloud.point_step) == ("rear", 600, 12)
    assert (cloud.header.stamp.sec, cloud.header.stamp.nanosec) == divmod(STAMP_NS, 10**9)
    assert [field.name for field in cloud.fields] == ["x", "y", "z"]
    assert durability["/tf_static"] is QosDurability.TRANSIENT_LOCAL
    assert durability["/log"] is QosDurability.VOLATILE
    assert (depth["/tf_static"], depth["/log"]) == (1, 10)
    with AnyReader([files["ros2", "running"]]) as reader:
        lines = [reader.deserialize(raw, one.msgtype).msg for one, _, raw in reader.messages() if one.topic == "/log"]
    assert lines[-1] == "stage fine finished"
    assert any("calibration complete" in line.msg for line in found["/log"])
    metrics = {one["name"]: one for one in json.loads(found["/metrics"][0].data)["lidars"]}
    assert metrics["rear"]["fitness"] == 0.8


@pytest.mark.parametrize("encoding", ["foxglove", "ros2"])
def test_points_are_preprocessed_in_the_lidars_own_frame(files, encoding):
    *_, expected = (event.cloud for event in made_events() if hasattr(event, "cloud"))
    assert expected.lidar == "top"
    with files[encoding, "complete"].open("rb") as file:
        data = next(m.data for _, c, m in make_reader(file).iter_messages() if c.topic == "/lidar/top/points")
    assert np.asarray(expected.points_m, dtype="<f4").tobytes() in data


def test_what_is_not_placed_has_a_cloud_and_no_transform(files):
    with AnyReader([files["ros2", "partial"]]) as reader:
        messages = {c.topic: reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages()}
    assert "rear" not in {one.child_frame_id for one in messages["/tf_static"].transforms}
    assert messages["/lidar/rear/points"].width == 600


@pytest.mark.parametrize("encoding", ["foxglove", "ros2"])
def test_reruns_own_loader_sees_clouds_and_transforms(files, encoding):
    expected = {"Points3D:positions", "TextLog:text", "CoordinateFrame:frame"}
    assert expected | {"Transform3D:child_frame"} <= columns_in_rerun(files[encoding, "complete"])
    assert expected <= columns_in_rerun(files[encoding, "running"])


def columns_in_rerun(path: Path) -> set[str]:
    return {name for chunk in McapReader(path).stream() for name in chunk.to_record_batch().schema.names}


@pytest.mark.slow
@pytest.mark.parametrize(("outcome", "status"), [("complete", "complete"), ("running", "unfinished")])
@pytest.mark.parametrize("encoding", ["foxglove", "ros2"])
@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
@pytest.mark.skipif(not NODE_MODULES.is_dir(), reason=f"run: {HOW_TO_INSTALL}")
def test_the_reader_of_mcap_core_agrees(files, encoding, outcome, status):
    command = ["node", str(Path(__file__).parent / "read_mcap.cjs"), str(files[encoding, outcome])]
    environment = {**os.environ, "NODE_PATH": str(NODE_MODULES)}
    finished = subprocess.run(command, capture_output=True, text=True, check=True, env=environment, timeout=60)
    seen = json.loads(finished.stdout)
    assert seen["topics"] == topics_of(files[encoding, outcome])
    assert seen["counts"]["/lidar/top/points"] == 1
    assert seen["counts"]["/log"] > len(LIDARS)
    assert seen["attachments"] == ["config.toml", "result.json", "foxglove-layout.json"]
    assert seen["metadata"]["multilica"]["status"] == status


def test_names_that_ros_spells_alike_keep_topics_of_their_own():
    encoding = Ros2Encoding()
    names = ("front left", "front_left", "front/left", "3d")
    topics = [encoding.cloud(name, name, np.zeros((1, 3), np.float32), STAMP_NS).topic for name in names]
    tokens = ["front_left", "front_left_2", "front_left_3", "_3d"]
    assert topics == [f"/lidar/{token}/points" for token in tokens]
    assert encoding.cloud("front_left", "front_left", np.zeros((1, 3), np.float32), STAMP_NS).topic == topics[1]


@pytest.mark.parametrize("encoding", ["foxglove", "ros2"])
def test_a_clock_that_was_never_set_costs_nothing_but_the_time(tmp_path, encoding):
    with ResultMcap(tmp_path / "result.mcap", encoding) as observe:
        started, *others = made_events()
        lidars = tuple(
            replace(lidar, scans=tuple(replace(scan, stamp_ns=2**62) for scan in lidar.scans))
            for lidar in started.snapshot.lidars
        )
        for event in (replace(started, snapshot=replace(started.snapshot, lidars=lidars)), *others):
            observe(event)
    with (tmp_path / "result.mcap").open("rb") as file:
        assert min(message.log_time for _, _, message in make_reader(file).iter_messages()) == 10**9


def test_what_others_wrote_is_attached_if_it_is_there(tmp_path):
    report, missing = tmp_path / "report.html", tmp_path / "missing.html"
    with ResultMcap(tmp_path / "result.mcap", attached=(report, missing)) as observe:
        for event in made_events():
            observe(event)
        report.write_text("<html>the end</html>")
    with (tmp_path / "result.mcap").open("rb") as file:
        attachments = {one.name: one for one in make_reader(file).iter_attachments()}
    assert attachments["report.html"].data == b"<html>the end</html>"
    assert attachments["report.html"].media_type == "text/html"
    assert "missing.html" not in attachments


def test_an_unknown_encoding_is_refused_by_name(tmp_path):
    with pytest.raises(UnknownNameError, match=r"no MCAP encoding 'ros1'.*foxglove, ros2"):
        ResultMcap(tmp_path / "result.mcap", "ros1")
