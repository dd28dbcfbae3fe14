# SPDX-License-Identifier: Apache-2.0
"""Readers of every format that share no code with the product, as the programs behind the formats read them."""

from __future__ import annotations

import csv
import json
import shlex
import sys
import tomllib
import types
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from transforms3d.euler import euler2mat
from transforms3d.quaternions import quat2mat
from urdf_parser_py.urdf import URDF

Poses = dict[tuple[str, str], np.ndarray]
"""The pose of a child in its parent, by (parent, child)."""


def matrix(rotation: np.ndarray, xyz: Iterable[float]) -> np.ndarray:
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = rotation, list(xyz)
    return found


def of_fixed_axes(xyz: Iterable[float], rpy: Iterable[float]) -> np.ndarray:
    return matrix(euler2mat(*rpy, axes="sxyz"), xyz)


def of_quaternion(xyz: Iterable[float], x: float, y: float, z: float, w: float) -> np.ndarray:
    return matrix(quat2mat([w, x, y, z]), xyz)


def read_urdf(path: Path) -> Poses:
    robot = URDF.from_xml_string(path.read_bytes())
    return {
        (joint.parent, joint.child): of_fixed_axes(joint.origin.xyz, joint.origin.rpy)
        for joint in robot.joints
        if joint.origin is not None
    }


def ros2_node(words: list[str]) -> Poses:
    """As `parse_args` of tf2_ros: every argument is a flag with a value."""
    assert len(words) == 18
    given = dict(zip(words[::2], words[1::2], strict=True))
    numbers = {name.removeprefix("--"): float(text) for name, text in given.items() if not name.endswith("frame-id")}
    xyz = [numbers.pop(name) for name in "xyz"]
    turn = [numbers.pop(name) for name in ("qx", "qy", "qz", "qw")]
    assert numbers == {}
    return {(given["--frame-id"], given["--child-frame-id"]): of_quaternion(xyz, *turn)}


def ros1_node(words: list[str]) -> Poses:
    """As `main` of tf2_ros: seven numbers and two frames."""
    assert len(words) == 9
    numbers = [float(word) for word in words[:7]]
    return {(words[7], words[8]): of_quaternion(numbers[:3], *numbers[3:])}


def joined(found: Iterable[Poses]) -> Poses:
    return {key: pose for poses in found for key, pose in poses.items()}


def read_ros2_xml(path: Path) -> Poses:
    nodes = ET.parse(path).getroot().findall("node")  # noqa: S314 - our own file
    assert {(node.get("pkg"), node.get("exec")) for node in nodes} == {("tf2_ros", "static_transform_publisher")}
    return joined(ros2_node(shlex.split(node.get("args", ""))) for node in nodes)


def read_ros2_yaml(path: Path) -> Poses:
    nodes = [entry["node"] for entry in yaml.safe_load(path.read_text(encoding="utf-8"))["launch"]]
    assert {(node["pkg"], node["exec"]) for node in nodes} == {("tf2_ros", "static_transform_publisher")}
    return joined(ros2_node(shlex.split(node["args"])) for node in nodes)


def read_ros2_python(path: Path) -> Poses:
    """Run the launch file with classes of `launch` and `launch_ros` that keep what they are given."""
    launch, launch_ros, actions = (types.ModuleType(name) for name in ("launch", "launch_ros", "launch_ros.actions"))
    launch.LaunchDescription = list
    actions.Node = dict
    with pytest.MonkeyPatch.context() as patch:
        for module in (launch, launch_ros, actions):
            patch.setitem(sys.modules, module.__name__, module)
        names: dict[str, object] = {}
        exec(path.read_text(encoding="utf-8"), names)  # noqa: S102
        nodes = names["generate_launch_description"]()
    assert {(node["package"], node["executable"]) for node in nodes} == {("tf2_ros", "static_transform_publisher")}
    return joined(ros2_node(node["arguments"]) for node in nodes)


def read_commands(path: Path) -> Poses:
    lines = [shlex.split(line) for line in path.read_text(encoding="utf-8").splitlines()]
    assert {tuple(words[:4]) for words in lines} == {("ros2", "run", "tf2_ros", "static_transform_publisher")}
    return joined(ros2_node(words[4:]) for words in lines)


def read_ros1(path: Path) -> Poses:
    nodes = ET.parse(path).getroot().findall("node")  # noqa: S314 - our own file
    assert {(node.get("pkg"), node.get("type")) for node in nodes} == {("tf2_ros", "static_transform_publisher")}
    return joined(ros1_node(node.get("args", "").split()) for node in nodes)


def read_tf_static(path: Path) -> Poses:
    found: Poses = {}
    with path.open("rb") as file:
        chunks = [each for each in StreamReader(file, emit_chunks=True).records if isinstance(each, Chunk)]
        assert all(chunk.uncompressed_crc for chunk in chunks)
        file.seek(0)
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, _, message in reader.iter_decoded_messages():
            assert channel.topic == "/tf_static"
            assert "durability: 1" in channel.metadata["offered_qos_profiles"]
            for each in message.transforms:
                place, turn = each.transform.translation, each.transform.rotation
                key = each.header.frame_id, each.child_frame_id
                found[key] = of_quaternion((place.x, place.y, place.z), turn.x, turn.y, turn.z, turn.w)
    return found


def read_autoware(path: Path) -> Poses:
    """As `xacro.load_yaml` reads it for the origins of joints; its numbers are YAML 1.1's."""
    document = yaml.safe_load(path.read_text(encoding="utf-8"))
    return {
        (parent, child): of_fixed_axes([at[key] for key in "xyz"], [at[key] for key in ("roll", "pitch", "yaw")])
        for parent, children in document.items()
        for child, at in children.items()
        if all(isinstance(value, float) for value in at.values())
    }


def read_kalibr(path: Path) -> Poses:
    entries = yaml.safe_load(path.read_text(encoding="utf-8")).values()
    return {(entry["base_frame"], entry["frame"]): np.array(entry["T_base_lidar"], dtype=float) for entry in entries}


def read_kitti(path: Path) -> Poses:
    found = {}
    for line in path.read_text(encoding="utf-8").splitlines():
        key, value = line.split(":", 1)
        source, target = key.removeprefix("Tr_").split("_to_")
        found[target, source] = np.vstack([np.array(value.split(), dtype=float).reshape(3, 4), [0, 0, 0, 1]])
    return found


def read_matrices(path: Path) -> Poses:
    stacked = np.loadtxt(path).reshape(-1, 4, 4)
    lines = path.read_text(encoding="utf-8").splitlines()
    frames = [line.split()[2:] for line in lines if line.startswith("# T_target_source ")]
    return {(target, source): pose for (target, source), pose in zip(frames, stacked, strict=True)}


def read_opencalib(path: Path) -> Poses:
    """As `LoadExtrinsic` of SensorsCalibration: `A-to-B-extrinsic` takes the points of A to B."""
    found = {}
    for name, entry in json.loads(path.read_text(encoding="utf-8")).items():
        source, target = name.removesuffix("-extrinsic").split("-to-")
        matrix = entry["param"]["sensor_calib"]
        found[target, source] = np.array(matrix["data"]).reshape(matrix["rows"], matrix["cols"])
    return found


def read_csv(path: Path) -> Poses:
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    found = {}
    for row in rows:
        xyz = [float(row[name]) for name in ("x_m", "y_m", "z_m")]
        pose = of_quaternion(xyz, *(float(row[name]) for name in ("qx", "qy", "qz", "qw")))
        angles = np.deg2rad([float(row[name]) for name in ("roll_deg", "pitch_deg", "yaw_deg")])
        np.testing.assert_allclose(of_fixed_axes(xyz, angles), pose, rtol=0, atol=1e-9)
        found[row["target"], row["source"]] = pose
    return found


def read_toml(path: Path) -> Poses:
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    found = {}
    for name, entry in document["lidars"].items():
        x, y, z, w = entry["quaternion_xyzw"]
        pose = np.array(entry["T_target_source"])
        for other in (
            of_quaternion(entry["xyz_m"], x, y, z, w),
            of_fixed_axes(entry["xyz_m"], np.deg2rad(entry["rpy_deg"])),
        ):
            np.testing.assert_allclose(other, pose, rtol=0, atol=1e-9)
        found[document["target"], name] = pose
    return found


READERS = {
    ("toml", ".toml"): read_toml,
    ("urdf", ".urdf"): read_urdf,
    ("ros2-launch", ".py"): read_ros2_python,
    ("ros2-launch", ".xml"): read_ros2_xml,
    ("ros2-launch", ".yaml"): read_ros2_yaml,
    ("ros2-static", ".sh"): read_commands,
    ("ros2-static", ".txt"): read_commands,
    ("ros1-launch", ".launch"): read_ros1,
    ("tf-static", ".mcap"): read_tf_static,
    ("autoware", ".yaml"): read_autoware,
    ("kalibr", ".yaml"): read_kalibr,
    ("kitti", ".txt"): read_kitti,
    ("matrices", ".txt"): read_matrices,
    ("opencalib", ".json"): read_opencalib,
    ("csv", ".csv"): read_csv,
}
"""By format and suffix."""
