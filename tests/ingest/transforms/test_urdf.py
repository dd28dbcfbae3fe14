# SPDX-License-Identifier: Apache-2.0
"""URDF files in whatever state they are."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from multilica.errors import SourceNotFoundError, UnreadableSourceError
from multilica.ingest.transforms import read_urdf

JOINT = '<joint name="j" type="fixed"><parent link="base"/><child link="roof"/>{}</joint>'
XACRO = '<robot name="car" xmlns:xacro="http://www.ros.org/wiki/xacro">{}</robot>'


def urdf(path: Path, body: str, head: str = "<?xml version='1.0'?>") -> Path:
    path.write_text(f'{head}<robot name="car"><link name="base"/>{body}</robot>', encoding="utf-8")
    return path


def test_an_origin_is_the_pose_of_the_child_in_extrinsic_xyz(tmp_path: Path) -> None:
    origin = '<origin xyz=" 1 -2.5\t3e-1" rpy="0.1 0.2 0.3"/>'
    (joint,) = read_urdf(urdf(tmp_path / "car.urdf", JOINT.format(origin)))
    pose = joint.T_parent_child
    assert (joint.name, joint.kind, pose.target, pose.source) == ("j", "fixed", "base", "roof")
    np.testing.assert_allclose(pose.xyz_m, [1.0, -2.5, 0.3])
    np.testing.assert_allclose(pose.rpy_rad, [0.1, 0.2, 0.3])
    roll, pitch, yaw = (_turn(axis, angle) for axis, angle in enumerate((0.1, 0.2, 0.3)))
    np.testing.assert_allclose(pose.rotation, yaw @ pitch @ roll, atol=1e-12)


def _turn(axis: int, angle: float) -> np.ndarray:
    one, other = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[[one, other], [one, other]] = np.cos(angle)
    matrix[one, other], matrix[other, one] = -np.sin(angle), np.sin(angle)
    return matrix


@pytest.mark.parametrize(
    ("origin", "xyz_m", "rpy_rad"),
    [("", (0, 0, 0), (0, 0, 0)), ('<origin rpy="0 0 1"/>', (0, 0, 0), (0, 0, 1)), ("<origin/>", (0, 0, 0), (0, 0, 0))],
)
def test_what_an_origin_leaves_out_is_zero(tmp_path: Path, origin: str, xyz_m: tuple, rpy_rad: tuple) -> None:
    (joint,) = read_urdf(urdf(tmp_path / "car.urdf", JOINT.format(origin)))
    np.testing.assert_allclose(joint.T_parent_child.xyz_m, xyz_m)
    np.testing.assert_allclose(joint.T_parent_child.rpy_rad, rpy_rad, atol=1e-12)


def test_only_the_robots_own_joints_count(tmp_path: Path) -> None:
    other = '<transmission name="t"><joint name="j"/></transmission><gazebo><joint name="k"/></gazebo>'
    (joint,) = read_urdf(urdf(tmp_path / "car.urdf", JOINT.format("") + other))
    assert (joint.T_parent_child.target, joint.T_parent_child.source) == ("base", "roof")


def test_a_file_may_be_nested_64_levels_deep(tmp_path: Path) -> None:
    assert read_urdf(urdf(tmp_path / "car.urdf", "<a>" * 63 + "</a>" * 63)) == ()


def test_a_namespace_of_xacro_without_macros_is_no_fault(tmp_path: Path) -> None:
    path = tmp_path / "car.urdf"
    path.write_text(XACRO.format("<!-- made from <xacro:lidar/> -->" + JOINT.format("")), encoding="utf-8")
    assert len(read_urdf(path)) == 1


@pytest.mark.parametrize(
    ("body", "told"),
    [
        ('<joint name="j"><parent link="a"/><child link="b"/></joint>', "joint 'j' has no type"),
        ('<joint name="j" type="fixed"><child link="b"/></joint>', "joint 'j' has no parent link"),
        ('<joint name="j" type="fixed"><parent link="a"/><child/></joint>', "joint 'j' has no child link"),
        ('<joint name="j" type="fixed"><parent link="a"/><child link="a"/></joint>', "joins 'a' to itself"),
        (JOINT.format('<origin xyz="1 2"/>'), "joint 'j' has xyz '1 2', expected three numbers"),
        (JOINT.format('<origin rpy="0 0 ${pi}"/>'), "joint 'j' has rpy '0 0 ${pi}', expected three numbers"),
        (JOINT.format('<origin xyz="0 0 nan"/>'), "expected three numbers"),
        (JOINT.format("") + JOINT.format("").replace("base", "bumper"), "link 'roof' is the child of 2 joints"),
        ("<joint", "is not a valid XML file"),
        ("<a>" * 64 + "</a>" * 64, "nested more than 64 levels deep"),
        ("<a/>" * (1 << 20), "more than 4194304 bytes"),
    ],
)
def test_a_broken_file_is_refused_in_one_sentence(tmp_path: Path, body: str, told: str) -> None:
    path = urdf(tmp_path / "car.urdf", body)
    _assert_refused(path, told)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (b"", "is not a valid XML file"),
        (b"\xff\xfe\x00", "is not a valid XML file"),
        (b"<?xml version='1.0' encoding='klingon'?><robot/>", "is not a valid XML file"),
        (b"<sdf><model/></sdf>", "begins with <sdf>; expected <robot>"),
        (XACRO.format('<xacro:lidar name="front"/>').encode(), "run xacro first"),
    ],
)
def test_what_is_no_urdf_is_named(tmp_path: Path, text: bytes, told: str) -> None:
    path = tmp_path / "car.urdf"
    path.write_bytes(text)
    _assert_refused(path, told)


def test_a_xacro_file_is_refused_by_its_name(tmp_path: Path) -> None:
    _assert_refused(urdf(tmp_path / "car.urdf.xacro", JOINT.format("")), r"run xacro first \(xacro car.urdf.xacro")


def test_entities_are_refused_before_they_grow(tmp_path: Path) -> None:
    head = '<!DOCTYPE robot [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
    _assert_refused(urdf(tmp_path / "car.urdf", "&b;", head), "defines XML entities")


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(SourceNotFoundError, match=r"No URDF file at .*nowhere\.urdf\."):
        read_urdf(tmp_path / "nowhere.urdf")


def _assert_refused(path: Path, told: str) -> None:
    with pytest.raises(UnreadableSourceError, match=told.replace("${pi}", r"\$\{pi\}")) as refusal:
        read_urdf(path)
    assert path.name in str(refusal.value)
    assert len(str(refusal.value).splitlines()) == 1


def test_degrees_are_refused(tmp_path: Path) -> None:
    path = urdf(tmp_path / "car.urdf", JOINT.format('<origin rpy="0 0 90"/>'))
    with pytest.raises(UnreadableSourceError, match="joint 'j' has rpy '0 0 90', expected radians"):
        read_urdf(path)
    full_turn = urdf(tmp_path / "turn.urdf", JOINT.format('<origin rpy="0 0 6.2832"/>'))
    assert len(read_urdf(full_turn)) == 1
