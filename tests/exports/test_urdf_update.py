# SPDX-License-Identifier: Apache-2.0
"""Existing files keep what is not a pose of the rig."""

from __future__ import annotations

import itertools
import re
from pathlib import Path

import numpy as np
import pytest
import yaml

import multilica
from multilica.errors import InputError, UnreadableSourceError
from multilica.exports import export_extrinsics
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from tests.exports.independent_readers import read_urdf

CAR = """<?xml version='1.0' encoding='utf-8'?>\r
<!-- <joint name="old"><child link="left"/></joint> -->
<robot name='car'  xmlns:x="http://example.org/x">
  <link name="base"/><link name="roof"/><link name="front"/><link name="left"/><link name="rear"/><link name="wheel"/>
\t<joint type="fixed" name="roof_joint"><parent link="base"/><child link="roof"/><origin xyz="1 0 2" rpy="0 0 1.5707963267948966"/></joint>
  <joint name="front_joint" type="fixed">
    <parent link="roof"/> <child link="front"/>
    <origin rpy='0 0.1 0'
            xyz='2 0 0' note="a > b"/>
  </joint>
  <joint name="left_joint" type="fixed"><origin  xyz = "9 9 9" /><parent link="base"/><child link="left"/><axis xyz="0 0 1"/></joint>
  <joint name="rear_joint" type="fixed"><!-- no origin: Rück --><parent link="left"/><child link="rear"/></joint>
  <joint name="steering" type="revolute"><parent link="base"/><child link="wheel"/><origin xyz="5 5 5"/></joint>
  <joint name="hub" type="fixed"><parent link="wheel"/><child link="cap"/></joint><link name="cap"/>
  <gazebo><joint name="x"><child link="left"/><origin xyz="7 7 7"/></joint></gazebo>
</robot>
"""  # noqa: E501


def pose(target: str, source: str, *values: float) -> RigidTransform:
    return RigidTransform.from_xyz_rpy(target, source, values[:3], values[3:])


def rig(target: str = "front", **poses: tuple[float, ...]) -> Extrinsics:
    return Extrinsics(target, {name: pose(target, name, *values) for name, values in poses.items()})


RIG = rig(left=(0.1, 0.7, -0.2, 0.3, 0.2, 1.5), rear=(-3.0, 0.0, 0.1, 0.0, 0.01, 3.1))


@pytest.fixture
def car(tmp_path: Path) -> Path:
    (tmp_path / "car.urdf").write_bytes(CAR.encode())
    return tmp_path / "car.urdf"


def chained(path: Path, *links: str) -> np.ndarray:
    poses = read_urdf(path)
    return np.linalg.multi_dot([np.eye(4), np.eye(4), *(poses[pair] for pair in itertools.pairwise(links))])


def test_origins_are_updated_relative_to_their_parents(car: Path) -> None:
    before = chained(car, "base", "roof", "front")
    export_extrinsics(RIG, car, "urdf")
    after = chained(car, "base", "roof", "front")
    np.testing.assert_array_equal(after, before)
    front = np.linalg.inv(after)
    for links in (("base", "left"), ("base", "left", "rear")):
        expected = RIG.between("front", links[-1]).matrix
        np.testing.assert_allclose(front @ chained(car, *links), expected, rtol=0, atol=1e-9)


def test_the_rest_of_the_file_stays_to_the_byte(car: Path) -> None:
    export_extrinsics(RIG, car, "urdf")
    updated = car.read_bytes().decode()
    number = r"-?[\d.]+(?:e-?\d+)?"
    three = f"{number} {number} {number}"
    pattern = re.escape(CAR)
    pattern = pattern.replace(re.escape('xyz = "9 9 9" /'), f'xyz="{three}" rpy="{three}" /')
    pattern = pattern.replace(
        re.escape('<joint name="rear_joint" type="fixed">'),
        re.escape('<joint name="rear_joint" type="fixed">') + f'<origin xyz="{three}" rpy="{three}"/>',
    )
    assert re.fullmatch(pattern, updated)


def test_an_update_is_repeatable(car: Path) -> None:
    export_extrinsics(RIG, car, "urdf")
    first = multilica.read_extrinsics(car)
    export_extrinsics(RIG, car, "urdf")
    for name in first.members - {"wheel", "cap"}:
        again = multilica.read_extrinsics(car).between("front", name)
        np.testing.assert_allclose(again.matrix, first.between("front", name).matrix, rtol=0, atol=1e-12)


def test_the_target_takes_a_pose_in_another_link(car: Path) -> None:
    new = rig("base", front=(3.0, 0.1, 1.9, 0.0, 0.02, 0.0), left=(1.0, 0.9, 1.8, 0.0, 0.0, 1.6))
    export_extrinsics(new, car, "urdf")
    np.testing.assert_allclose(chained(car, "base", "roof", "front"), new.between("base", "front").matrix, atol=1e-9)
    np.testing.assert_allclose(chained(car, "base", "left"), new.between("base", "left").matrix, atol=1e-9)
    assert 'rpy="0.0 0.02' not in car.read_text(encoding="utf-8")  # the roof is turned
    assert 'note="a > b"' in car.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("new", "sentence"),
    [
        (rig(top=(0, 0, 0, 0, 0, 0)), "no joint with the child link 'top'; found cap, front, left"),
        (rig("top", left=(0, 0, 0, 0, 0, 0)), "no link 'top'"),
        (rig(wheel=(0, 0, 0, 0, 0, 0)), "'steering', a revolute joint, above 'wheel'"),
        (rig(cap=(0, 0, 0, 0, 0, 0)), "joined to 'wheel' through 'steering', a revolute joint"),
        (rig("rear", left=(0, 0, 0, 0, 0, 0)), "mounts 'rear' on 'left'"),
    ],
)
def test_poses_that_the_file_cannot_take(car: Path, new: Extrinsics, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        export_extrinsics(new, car, "urdf")
    assert car.read_bytes().decode() == CAR


def test_a_file_that_is_no_tree_is_not_updated(car: Path) -> None:
    text = CAR.replace('<parent link="base"/><child link="left"/>', '<parent link="other"/><child link="left"/>')
    car.write_text(text, encoding="utf-8")
    with pytest.raises(UnreadableSourceError, match="2 roots, 'base', 'other'"):
        export_extrinsics(RIG, car, "urdf")


def test_other_encodings(car: Path) -> None:
    car.write_bytes(CAR.replace("utf-8", "iso-8859-1").encode("latin-1"))
    export_extrinsics(RIG, car, "urdf")
    assert "no origin: Rück" in car.read_bytes().decode("latin-1")
    car.write_bytes(CAR.replace("utf-8", "utf-16").encode("utf-16"))
    with pytest.raises(UnreadableSourceError, match="is in UTF-16"):
        export_extrinsics(RIG, car, "urdf")


KIT = """\
# measured in March
sensor_kit_base_link: # on the roof
  "camera0/camera_link": {x: 0.10, y: 1e-3, z: 2, roll: 0, pitch: 0.0, yaw: -1.50}
  front:
    x: 0.1  # tape
    y: 0.0
    z: 0.0
    roll: 0.0
    pitch: 0.0
    yaw: 0.0
"""


def test_an_autoware_file_keeps_its_other_sensors(tmp_path: Path) -> None:
    kit = tmp_path / "sensor_kit_calibration.yaml"
    kit.write_text(KIT, encoding="utf-8")
    new = rig("sensor_kit_base_link", front=(1e-7, 2.0, 3.0, 1e-9, 0.2, 0.3), rear=(1.0, 2.0, 3.0, 0.1, 0.2, 0.3))
    export_extrinsics(new, kit, "autoware")
    text = kit.read_text(encoding="utf-8")
    assert text.startswith("\n".join(KIT.splitlines()[:4]))
    assert "# tape" in text
    found = yaml.safe_load(text)["sensor_kit_base_link"]
    assert list(found["front"].values()) == pytest.approx([1e-7, 2.0, 3.0, 1e-9, 0.2, 0.3], abs=1e-12)
    assert list(found["rear"].values()) == pytest.approx([1.0, 2.0, 3.0, 0.1, 0.2, 0.3], abs=1e-12)
    with pytest.raises(UnreadableSourceError, match="2 roots, 'base', 'sensor_kit_base_link'"):
        export_extrinsics(rig("base", left=(0, 0, 0, 0, 0, 0)), kit, "autoware")
    assert kit.read_text(encoding="utf-8") == text
