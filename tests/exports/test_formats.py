# SPDX-License-Identifier: Apache-2.0
"""Every format against a reader of its own, and read back."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import multilica
from multilica.errors import UsageError
from multilica.exports import FORMATS, export_extrinsics
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from tests.exports.independent_readers import READERS
from tests.exports.made_rigs import HARD_ANGLES, XYZ_M, assert_same, made_rig

KINDS = sorted((name, suffix) for name, each in FORMATS.items() for suffix in each.writers)
ROS = [kind for kind in KINDS if kind[0] in ("ros1-launch", "ros2-launch", "ros2-static")]


def test_every_format_has_a_reader_of_its_own() -> None:
    assert sorted(READERS) == KINDS


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS, ids="".join)
def test_others_read_the_same_poses(tmp_path: Path, kind: tuple[str, str]) -> None:
    name, suffix = kind
    rig = made_rig()
    found = READERS[kind](export_extrinsics(rig, tmp_path / f"rig{suffix}", name))
    assert sorted(found) == sorted(("base_link", frame) for frame in HARD_ANGLES)
    for (_, frame), pose in found.items():
        np.testing.assert_allclose(pose, rig.between("base_link", frame).matrix, rtol=0, atol=1e-9, err_msg=frame)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS, ids="".join)
def test_what_is_written_is_read_back(tmp_path: Path, kind: tuple[str, str]) -> None:
    name, suffix = kind
    path = export_extrinsics(made_rig(), tmp_path / f"rig{suffix}", name)
    for found in (multilica.read_extrinsics(path), multilica.read_extrinsics(str(path), format=name)):
        assert found.target == "base_link"
        assert_same(found, made_rig())


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if "launch" in kind[0] or kind[0] == "urdf"], ids="".join)
def test_joints_and_nodes_have_names_of_their_own(tmp_path: Path, kind: tuple[str, str]) -> None:
    name, suffix = kind
    text = export_extrinsics(made_rig(), tmp_path / f"rig{suffix}", name).read_text(encoding="utf-8")
    found = re.findall(r'joint name="(\w+)_joint"|static_transform_(?!publisher)(\w+)', text)
    assert sorted(map("".join, found)) == sorted(HARD_ANGLES)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if "launch" in kind[0]], ids="".join)
def test_nodes_of_like_frames_have_names_of_their_own(tmp_path: Path, kind: tuple[str, str]) -> None:
    name, suffix = kind
    frames = ("os-0", "os_0", "os_0_2", "os.0")
    rig = Extrinsics("base", {frame: RigidTransform.identity("base", frame) for frame in frames})
    text = export_extrinsics(rig, tmp_path / f"rig{suffix}", name).read_text(encoding="utf-8")
    found = re.findall(r"static_transform_(?!publisher)\w+", text)
    assert len(found) == len(set(found)) == len(frames)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS, ids="".join)
def test_the_same_rig_gives_the_same_bytes(tmp_path: Path, kind: tuple[str, str]) -> None:
    name, suffix = kind
    rig = made_rig()
    turned = Extrinsics(rig.target, dict(reversed(rig.T_target_source.items())))
    first, second = (export_extrinsics(each, tmp_path / f"{each is rig}{suffix}", name) for each in (rig, turned))
    assert first.read_bytes() == second.read_bytes()


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind not in ROS and kind[0] != "kitti"], ids="".join)
def test_odd_names_survive(tmp_path: Path, kind: tuple[str, str]) -> None:
    name, suffix = kind
    names = ["no", "1.5", "a b", "<'&\">", "über: #1", "-to-", "null", "{x}", "[y]", "*z", "lidar/top", "a=b"]
    rig = Extrinsics("yes", {each: RigidTransform.from_xyz_rpy("yes", each, XYZ_M, (0.1, 0.2, 0.3)) for each in names})
    assert_same(multilica.read_extrinsics(export_extrinsics(rig, tmp_path / f"rig{suffix}", name)), rig)


@pytest.mark.parametrize("frame", ["a b", "$(env HOME)", "a;reboot", "'", '"', "-x", "/left", "a\\b"])
@pytest.mark.parametrize("kind", ROS, ids="".join)
def test_ros_files_take_no_name_that_needs_quotes(tmp_path: Path, kind: tuple[str, str], frame: str) -> None:
    name, suffix = kind
    rig = Extrinsics("base", {frame: RigidTransform.identity("base", frame)})
    with pytest.raises(UsageError, match="cannot have the frame"):
        export_extrinsics(rig, tmp_path / f"rig{suffix}", name)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("frame", ["a_to_b", "a b", "a:b"])
def test_kitti_takes_no_ambiguous_name(tmp_path: Path, frame: str) -> None:
    rig = Extrinsics("base", {frame: RigidTransform.identity("base", frame)})
    with pytest.raises(UsageError, match="cannot have the frame"):
        export_extrinsics(rig, tmp_path / "rig.txt", "kitti")


@pytest.mark.parametrize(
    ("path", "name", "sentence"),
    [
        ("rig.txt", "urdf", "a name that ends in .urdf"),
        ("rig.json", "ros2-launch", "ends in .py or .xml or .yaml"),
        ("s3://bucket/rig.csv", "csv", "a file on this machine"),
        ("missing/rig.csv", "csv", "create it first"),
        ("rig.csv", "cvs", "Did you mean 'csv'"),
    ],
)
def test_wrong_outputs_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, path: str, name: str, sentence: str
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=sentence):
        export_extrinsics(made_rig(), path, name)
    assert list(tmp_path.iterdir()) == []
