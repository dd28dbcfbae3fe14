# SPDX-License-Identifier: Apache-2.0
"""Files as other programs write them, with the place of a point that tells every convention apart."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from transforms3d.euler import euler2mat

import multilica
from multilica.errors import InputError
from multilica.ingest.transforms import read_urdf
from multilica.sinks.snapshots import write_snapshot_mcap
from multilica.snapshot import LidarScans, Scan, Snapshot

RPY = (0.1, -0.2, 1.3)
XYZ = (1.0, 2.0, 3.0)
EXPECTED = np.eye(4)
EXPECTED[:3, :3], EXPECTED[:3, 3] = euler2mat(*RPY, axes="sxyz"), XYZ
QUATERNION = "0.099931 -0.049281 0.605383 0.788097"  # of RPY, to six digits
ROS1_NODE = '<launch><group><node pkg="{}" type="static_transform_publisher" name="n" args="{}"/></group></launch>'
ROS2_NODE = '<launch><node pkg="tf2_ros" exec="static_transform_publisher" args="{}"/></launch>'
NAMED = "--frame-id base --child-frame-id top"
FILES: Mapping[str, tuple[str, str]] = {
    "ROS 1 has yaw, pitch, roll": ("a.launch", ROS1_NODE.format("tf2_ros", "1 2 3 1.3 -0.2 0.1 base top")),
    "ROS 1 has quaternions": ("a.launch", ROS1_NODE.format("tf2_ros", f"1 2 3 {QUATERNION} base top")),
    "tf has a period": ("a.launch", ROS1_NODE.format("tf", "1 2 3 1.3 -0.2 0.1 /base /top 100")),
    "tf has a period after quaternions": ("a.launch", ROS1_NODE.format("tf", f"1 2 3 {QUATERNION} base top 100")),
    "ROS 2 has names": ("a.xml", ROS2_NODE.format(f"--x 1 --y 2 --z 3 --roll 0.1 --pitch -0.2 --yaw 1.3 {NAMED}")),
    "names in any order": ("a.xml", ROS2_NODE.format(f"{NAMED} --yaw 1.3 --pitch -0.2 --roll 0.1 --z 3 --y 2 --x 1")),
    "ROS 2 has old arguments": ("a.xml", ROS2_NODE.format("1 2 3 1.3 -0.2 0.1 base top")),
    "ROS 2 in Python": (
        "a.launch.py",
        (
            "import launch_ros\n"
            "X = launch_ros.actions.Node(package='tf2_ros', executable='static_transform_publisher',\n"
            "  arguments=['1', '2', '3', '1.3', '-0.2', '0.1', 'base', 'top'], output='screen')\n"
        ),
    ),
    "ROS 2 in YAML": (
        "a.launch.yml",
        (
            "launch:\n- group:\n  - node: {pkg: tf2_ros, exec: static_transform_publisher, "
            'args: "1 2 3 1.3 -0.2 0.1 base top --ros-args -r __node:=n"}\n'
        ),
    ),
    "a script": (
        "start",
        (
            "#!/bin/sh\n# static_transform_publisher of the roof\nros2 run tf2_ros static_transform_publisher \\\n"
            f"  --x 1 --y 2 --z 3 --roll 0.1 --pitch -0.2 --yaw 1.3 {NAMED} &\nwait\n"
        ),
    ),
    "a comment": ("start.sh", "static_transform_publisher 1 2 3 1.3 -0.2 0.1 base top # the roof"),
    "rosrun": ("start.sh", "rosrun tf static_transform_publisher 1 2 3 1.3 -0.2 0.1 base top 10\n"),
    "URDF": (
        "a.xml",
        (
            '<robot name="r"><joint name="j" type="fixed"><origin rpy="0.1 -0.2 1.3" xyz="1 2 3"/>'
            '<parent link="base"/><child link="top"/></joint></robot>'
        ),
    ),
    "Autoware": (
        "sensors_calibration.yaml",
        "base:\n  top:\n    x: 1\n    y: 2.0\n    z: 3.\n    roll: 0.1\n    pitch: -0.2\n    yaw: 1.3\n",
    ),
}


@pytest.mark.parametrize("name", FILES)
def test_files_of_others(tmp_path: Path, name: str) -> None:
    file, text = FILES[name]
    (tmp_path / file).write_text(text, encoding="utf-8")
    found = multilica.read_extrinsics(tmp_path / file).between("base", "top")
    np.testing.assert_allclose(found.matrix, EXPECTED, rtol=0, atol=2e-6 if QUATERNION in text else 1e-12)


def test_kitti_of_the_data_set(tmp_path: Path) -> None:
    text = (
        "P0: 7.2e+02 0 6.1e+02 0 0 7.2e+02 1.7e+02 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\n"
        "Tr_velo_to_cam: 7.533745e-03 -9.999714e-01 -6.166020e-04 -4.069766e-03 1.480249e-02 7.280733e-04 "
        "-9.998902e-01 -7.631618e-02 9.998621e-01 7.523790e-03 1.480755e-02 -2.717806e-01\n"
        "Tr_imu_to_velo: 1 0 0 -0.8 0 1 0 0.3 0 0 1 -0.8\n"
    )
    (tmp_path / "000000.txt").write_text(text, encoding="utf-8")
    found = multilica.read_extrinsics(tmp_path / "000000.txt")
    assert found.target == "cam"
    forward = found.between("cam", "velo").apply([[10.0, 0.0, 0.0]])[0]
    np.testing.assert_allclose(forward, [0.07, 0.07, 9.73], atol=0.01)  # along the optical axis of the camera
    np.testing.assert_allclose(found.between("cam", "imu").apply([[10.8, -0.3, 0.8]])[0], forward, atol=1e-9)


def test_opencalib_of_the_demo(tmp_path: Path) -> None:
    rows = "[[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]"
    text = f'{{"left-to-top-extrinsic": {{"param": {{"sensor_calib": {{"rows": 4, "cols": 4, "data": {rows}}}}}}}}}'
    (tmp_path / "a.json").write_text(text, encoding="utf-8")
    found = multilica.read_extrinsics(tmp_path / "a.json")
    np.testing.assert_allclose(found.between("top", "left").apply([[1.0, 0.0, 0.0]]), [[1.0, 3.0, 3.0]])


def test_a_matrix_may_be_rounded_up(tmp_path: Path) -> None:
    rows = "[[0, -1.0002, 0, 1], [1.0001, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]"
    text = f'{{"left-to-top-extrinsic": {{"param": {{"sensor_calib": {{"rows": 4, "cols": 4, "data": {rows}}}}}}}}}'
    (tmp_path / "a.json").write_text(text, encoding="utf-8")
    found = multilica.read_extrinsics(tmp_path / "a.json")
    np.testing.assert_allclose(found.between("top", "left").rpy_deg, [0.0, 0.0, 90.0], atol=1e-9)


def test_frames_are_chained_to_the_root(tmp_path: Path) -> None:
    level = "{x: 0, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0}"
    text = (
        f"kit:\n  top: {{x: 1, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0}}\n  imu: {level}\n"
        f"base:\n  kit: {{x: 0, y: 0, z: 2, roll: 0, pitch: 0, yaw: {math.pi / 2}}}\n"
    )
    (tmp_path / "both.yaml").write_text(text, encoding="utf-8")
    found = multilica.read_extrinsics(tmp_path / "both.yaml")
    assert (found.target, found.members) == ("base", {"base", "kit", "top", "imu"})
    np.testing.assert_allclose(found.between("base", "top").xyz_m, [0.0, 1.0, 2.0], atol=1e-12)


def joint(name: str, parent: str, child: str, kind: str) -> str:
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/></joint>'


def test_moving_joints_matter_only_between_what_is_asked_for(tmp_path: Path) -> None:
    joints = (
        joint("mount", "base", "roof", "fixed"),
        joint("steering", "base", "wheel", "revolute"),
        joint("hub", "wheel", "left", "fixed"),
        joint("hub2", "wheel", "right", "fixed"),
    )
    (tmp_path / "car.urdf").write_text(f'<robot name="r">{"".join(joints)}</robot>', encoding="utf-8")
    found = multilica.read_extrinsics(tmp_path / "car.urdf")
    assert len(read_urdf(tmp_path / "car.urdf")) == len(found.T_target_source) == 4
    found.between("base", "roof")
    found.between("left", "right")
    with pytest.raises(InputError, match="'left' is joined to 'roof' through 'steering', a revolute joint"):
        found.between("roof", "left")


def test_recordings_have_static_transforms(tmp_path: Path) -> None:
    transforms = tuple(multilica.RigidTransform(*frames, EXPECTED) for frames in (("base", "kit"), ("kit", "top")))
    lidar = LidarScans("top", (Scan(np.zeros((1, 3), np.float32), 1),), topic="/top")
    write_snapshot_mcap(Snapshot((lidar,), static_transforms=transforms), tmp_path / "drive.mcap")
    found = multilica.read_extrinsics(tmp_path / "drive.mcap")
    np.testing.assert_allclose(found.between("base", "top").matrix, EXPECTED @ EXPECTED, atol=1e-12)
