# SPDX-License-Identifier: Apache-2.0
"""Files that hold no usable extrinsics get one sentence."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import pytest

import multilica
from multilica.errors import SourceNotFoundError, UnknownNameError, UnreadableSourceError, UsageError
from multilica.exports.files import export_run
from tests.exports.test_conventions import ROS1_NODE, ROS2_NODE, joint
from tests.sinks.made_documents import made_document

AT = "{x: 0, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0}"
ROBOT = '<robot name="r">{}</robot>'
TWO_ROOTS = joint("j", "a", "b", "fixed") + joint("k", "c", "d", "fixed")
CYCLE = joint("j", "a", "b", "fixed") + joint("k", "b", "a", "fixed")
HANGING_CYCLE = CYCLE + joint("l", "c", "d", "fixed")
PYTHON = "Node(package='tf2_ros', executable='static_transform_publisher', arguments={})"
JSON = '{{"a-to-b-extrinsic": {{"param": {{"sensor_calib": {{"data": {}}}}}}}}}'
HEAD = "target,source,x_m,y_m,z_m,qx,qy,qz,qw\n"
BAD: Mapping[str, tuple[str, str, str]] = {
    "two roots": ("a.urdf", ROBOT.format(TWO_ROOTS), "2 roots, 'a', 'c'; expected one"),
    "five roots": (
        "a.csv",
        HEAD + "".join(f"{name},{name}0,0,0,0,0,0,0,1\n" for name in "abcde"),
        "5 roots, 'a', 'b', 'c' and 2 more; expected one",
    ),
    "three roots": (
        "a.csv",
        HEAD + "".join(f"{name},{name}0,0,0,0,0,0,0,1\n" for name in "abc"),
        "3 roots, 'a', 'b', 'c'; expected one",
    ),
    "a cycle": ("a.urdf", ROBOT.format(CYCLE), "cycle through"),
    "a cycle beside a tree": ("a.urdf", ROBOT.format(HANGING_CYCLE), "cycle through"),
    "two parents": ("a.yaml", f"a: {{c: {AT}}}\nb: {{c: {AT}}}\na0: {{a: {AT}, b: {AT}}}", "two parents, 'a' and 'b'"),
    "two poses": ("a.csv", HEAD + 2 * "a,b,0,0,0,0,0,0,1\n", "two poses in 'a'"),
    "its own parent": ("a.csv", HEAD + "a,a,0,0,0,0,0,0,1\n", "'a' is its own parent"),
    "no joints": ("a.urdf", ROBOT.format('<link name="a"/>'), "no transforms"),
    "degrees in URDF": (
        "a.urdf",
        ROBOT.format(joint("j", "a", "b", "fixed").replace("<parent", '<origin rpy="0 0 90"/><parent')),
        "expected radians",
    ),
    "a quaternion in URDF": (
        "a.urdf",
        ROBOT.format(joint("j", "a", "b", "fixed").replace("<parent", '<origin quat_xyzw="0 0 1 0"/><parent')),
        "joint 'j' has its rotation as quat_xyzw, expected rpy",
    ),
    "degrees in YAML": ("a.yaml", f"a: {{b: {AT.replace('yaw: 0', 'yaw: 90')}}}", "expected radians"),
    "degrees in ROS": ("a.launch", ROS1_NODE.format("tf2_ros", "0 0 0 90 0 0 a b"), "expected radians"),
    "other units": ("a.csv", HEAD.replace("x_m", "x_mm") + "a,b,0,0,0,0,0,0,1\n", "no column 'x_m'"),
    "a short quaternion": ("a.csv", HEAD + "a,b,0,0,0,0,0,0.5,0.5\n", "a quaternion of length 0.707; expected 1"),
    "a quaternion of zeros": ("a.xml", ROS2_NODE.format("0 0 0 0 0 0 0 a b"), "a quaternion of length 0; expected 1"),
    "a scaled matrix": ("a.txt", "# T_target_source a b\n2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n", "is not a rotation"),
    "a sensor without a name": (
        "a.json",
        '{"roof": {"sensor_name": "a", "target_sensor_name": 1, "param": {"sensor_calib": {"data": [[1]]}}}}',
        "names no two sensors",
    ),
    "a mirror": ("a.json", JSON.format("[[1,0,0,0],[0,1,0,0],[0,0,-1,0],[0,0,0,1]]"), "is not a rotation"),
    "a projection": ("a.json", JSON.format("[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,1,0]]"), "expected 0 0 0 1"),
    "five numbers": ("a.json", JSON.format("[[1,0,0,0,0]]"), "rows with 4 numbers"),
    "a matrix without frames": ("a.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "numbers above the first line"),
    "eleven numbers": ("a.txt", "Tr_a_to_b: 1 0 0 0 0 1 0 0 0 0 1\n", "11 numbers; expected 12"),
    "seven arguments": ("a.xml", ROS2_NODE.format("0 0 0 0 0 a b"), "has 7 arguments"),
    "a name twice": ("a.xml", ROS2_NODE.format("--x 1 --x 2 --frame-id a --child-frame-id b"), "pairs of a name"),
    "no child": ("a.xml", ROS2_NODE.format("--x 1 --frame-id a"), "lacks --frame-id or --child-frame-id"),
    "two rotations": ("a.xml", ROS2_NODE.format("--yaw 1 --qz 1 --frame-id a --child-frame-id b"), "both angles and"),
    "a substitution": ("a.xml", ROS2_NODE.format("$(var x) 0 0 0 0 0 a b"), "has a substitution"),
    "a condition": (
        "a.launch",
        ROS1_NODE.format("tf", "0 0 0 0 0 0 a b 9").replace("<group", '<group if="$(arg x)"'),
        "has a condition",
    ),
    "an open quote": ("a.xml", ROS2_NODE.format("0 0 0 0 0 0 a 'b"), "No closing quotation"),
    "a variable in Python": ("a.py", PYTHON.format("[x, '0']"), "line 1 has arguments that are not constants"),
    "a condition in Python": ("a.py", PYTHON.format("[], condition=c"), "line 1 has a condition"),
    "not Python": ("a.py", "def (", "not Python"),
    "deep Python": ("a.py", "(" * 5000, "not Python"),
    "missing values": ("a.yaml", "a: {b: {x: 0, y: 0}}", "expected x, y, z, roll, pitch, yaw"),
    "texts": ("a.yaml", f"a: {{b: {AT.replace('yaw: 0', 'yaw: east')}}}", "expected 6 numbers"),
    "a truth value": ("a.yaml", f"a: {{b: {AT.replace('yaw: 0', 'yaw: true')}}}", "expected 6 numbers"),
    "no number": ("a.yaml", f"a: {{b: {AT.replace('yaw: 0', 'yaw: .nan')}}}", "nan"),
    "an alias": ("a.yaml", f"a: {{b: &p {AT}, c: *p}}", "has an alias"),
    "a tag": ("a.yaml", "a: !!python/object:os.system {}", "has the tag"),
    "a list": ("a.yaml", "[1, 2]", "expected a table"),
    "not YAML": ("a.yaml", "a: {b: [", "in line 1"),
    "a long way": ("a.yaml", f"a: {{b: {AT.replace('x: 0', 'x: 1e12')}}}", "expected metres up to"),
    "not XML": ("a.launch", "<launch>", "not a valid XML file"),
    "other XML": ("a.launch", "<html/>", "expected <launch>"),
    "a robot": ("a.launch", "<robot/>", "expected <launch>"),
    "entities": ("a.launch", '<!DOCTYPE a [<!ENTITY b "c">]><launch>&b;</launch>', "defines XML entities"),
    "not UTF-8": ("a.txt", "\udcff", "not a UTF-8 text file"),
    "nothing": ("a.txt", "", "no transforms"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_files_are_refused(tmp_path: Path, name: str) -> None:
    file, text, sentence = BAD[name]
    (tmp_path / file).write_text(text, encoding="utf-8", errors="surrogateescape")
    with pytest.raises(UnreadableSourceError) as refused:
        multilica.read_extrinsics(tmp_path / file)
    assert sentence in str(refused.value)
    assert str(refused.value).startswith(str(tmp_path / file))
    assert str(refused.value).endswith(".")


def test_missing_files_and_unknown_formats(tmp_path: Path) -> None:
    with pytest.raises(SourceNotFoundError, match="No extrinsics file at"):
        multilica.read_extrinsics(tmp_path / "a.urdf")
    with pytest.raises(UnknownNameError, match="no format 'xacro'"):
        multilica.read_extrinsics(tmp_path / "a.urdf", format="xacro")


def test_a_recording_with_a_wrong_transform_is_refused(tmp_path: Path) -> None:
    from multilica.geometry import RigidTransform
    from multilica.sinks.snapshots import static_transforms_mcap

    twice = [RigidTransform.identity(parent, "c") for parent in ("a", "b")]
    (tmp_path / "a.mcap").write_bytes(static_transforms_mcap(twice))
    with pytest.raises(UnreadableSourceError, match="gives 'c' the parents a, b; expected one"):
        multilica.read_extrinsics(tmp_path / "a.mcap")


def test_a_base_frame_with_the_name_of_a_lidar_is_refused(tmp_path: Path) -> None:
    """A run of an earlier version may have one."""
    document = made_document("complete")
    document["ground"]["frame"] = "rear"
    (tmp_path / "result.json").write_text(json.dumps(document))
    with pytest.raises(UsageError, match="The base frame 'rear' of the run has the name of a LiDAR"):
        export_run(tmp_path, tmp_path / "rig.csv", "csv", base="rear")
    assert not (tmp_path / "rig.csv").exists()
