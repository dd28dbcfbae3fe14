# SPDX-License-Identifier: Apache-2.0
"""Tables of extrinsics that people write."""

from __future__ import annotations

import numpy as np
import pytest
import tomli_w

from multilica.errors import InputError, UnknownNameError, UnreadableSourceError
from multilica.extrinsics import EXTRINSICS_SCHEMA, Extrinsics, extrinsics_table, read_extrinsics_table, require_metres
from multilica.geometry import RigidTransform
from multilica.registration.poses import moved

HEAD = f'schema = "{EXTRINSICS_SCHEMA}"\ntarget = "base"\n[lidars.left]\n'


def test_position_and_angles_are_enough(tmp_path):
    path = tmp_path / "drawing.toml"
    path.write_text(f"{HEAD}xyz_m = [0.1, 0.6, 1.7]\nrpy_deg = [0, 45, -90]\n")
    expected = RigidTransform.from_xyz_rpy("base", "left", [0.1, 0.6, 1.7], [0.0, np.pi / 4, -np.pi / 2])
    np.testing.assert_allclose(
        read_extrinsics_table(str(path)).T_target_source["left"].matrix, expected.matrix, atol=1e-12
    )


def test_a_quaternion_replaces_the_angles(tmp_path):
    path = tmp_path / "drawing.toml"
    expected = RigidTransform.from_xyz_rpy("base", "left", [0.1, 0.6, 1.7], [0.0, np.pi / 4, -np.pi / 2])
    path.write_text(f"{HEAD}xyz_m = [0.1, 0.6, 1.7]\nquaternion_xyzw = {expected.quaternion_xyzw.tolist()}\n")
    found = read_extrinsics_table(path).T_target_source["left"]
    np.testing.assert_allclose(found.matrix, expected.matrix, atol=1e-12)
    path.write_text(f"{HEAD}xyz_m = [0.1, 0.6, 1.7]\nquaternion_xyzw = [0.0, 0.0, 1.0, 1.0]\n")
    with pytest.raises(UnreadableSourceError, match=r"'quaternion_xyzw' of length 1\.41; expected 1"):
        read_extrinsics_table(path)


@pytest.mark.parametrize(
    ("pose", "complaint"),
    [
        ("xyz_m = [0.1, 0.6, 1.7]", "it has no 'rpy_deg'; expected T_target_source, or xyz_m with rpy_deg or "),
        ("rpy_deg = [0, 45, -90]", "it has no 'xyz_m'"),
        ("xyz_m = [0.1, 0.6]\nrpy_deg = [0, 45, -90]", "is not a table of extrinsics"),
        ('xyz_m = [0.1, 0.6, 1.7]\nrpy_deg = "up"', "is not a table of extrinsics"),
    ],
)
def test_half_a_pose_is_refused_in_a_sentence(tmp_path, pose, complaint):
    path = tmp_path / "drawing.toml"
    path.write_text(f"{HEAD}{pose}\n")
    with pytest.raises(UnreadableSourceError, match=complaint):
        read_extrinsics_table(path)


@pytest.mark.parametrize("schema", ["multilica/extrinsics/0", "multilica/extrinsics/2", "multilica/result/1"])
def test_another_schema_is_refused(tmp_path, schema):
    path = tmp_path / "drawing.toml"
    path.write_text(f"{HEAD}xyz_m = [0.1, 0.6, 1.7]\nrpy_deg = [0, 45, -90]\n".replace(EXTRINSICS_SCHEMA, schema))
    with pytest.raises(UnreadableSourceError, match=f"has schema '{schema}'; expected '{EXTRINSICS_SCHEMA}'"):
        read_extrinsics_table(path)


def test_a_table_has_the_poses_only():
    pose = RigidTransform.from_xyz_rpy("top", "left", (1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    table = extrinsics_table(Extrinsics("top", {"left": pose}))
    assert {*table} == {"schema", "target", "convention", "length_unit", "rpy_convention", "lidars"}
    assert table["lidars"]["left"]["xyz_m"] == pytest.approx([1.0, 2.0, 3.0])


def _covariance(seed):
    root = np.random.default_rng(seed).normal(size=(6, 6))
    return 1e-5 * root @ root.T


def test_covariances_are_kept(tmp_path):
    pose = RigidTransform.from_xyz_rpy("top", "left", (1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    path = tmp_path / "rig.toml"
    table = extrinsics_table(Extrinsics("top", {"left": pose}, covariances={"left": _covariance(1)}))
    path.write_text(tomli_w.dumps(table))
    np.testing.assert_allclose(read_extrinsics_table(path).covariances["left"], _covariance(1), rtol=1e-12)


@pytest.mark.parametrize("broken", [-np.eye(6), np.diag([1.0, 1, 1, 1, 1, -0.1]), np.triu(np.ones((6, 6)))])
def test_a_damaged_covariance_is_refused(tmp_path, broken):
    path = tmp_path / "rig.toml"
    path.write_text(f"{HEAD}xyz_m = [0.1, 0.6, 1.7]\nrpy_deg = [0, 45, -90]\ncovariance = {broken.tolist()}\n")
    with pytest.raises(UnreadableSourceError, match="'covariance' is not symmetric and positive"):
        read_extrinsics_table(path)


def test_covariances_between_lidars_do_not_depend_on_the_frame():
    left = RigidTransform.from_xyz_rpy("top", "left", [0.1, 0.6, 1.7], [0.2, 0.5, -1.5])
    rear = RigidTransform.from_xyz_rpy("top", "rear", [-2.0, 0.1, 1.1], [-0.1, 0.3, 3.0])
    rig = Extrinsics("top", {"left": left, "rear": rear}, covariances={"left": _covariance(1), "rear": _covariance(2)})
    in_base = rig.seen_from(RigidTransform.from_xyz_rpy("base", "top", [1.0, 0.2, 2.0], [0.1, 0.02, 1.0]))
    np.testing.assert_array_equal(in_base.covariances["top"], np.zeros((6, 6)))
    for pair in (("top", "left"), ("left", "top"), ("left", "rear")):
        np.testing.assert_allclose(in_base.covariance_between(*pair), rig.covariance_between(*pair), atol=1e-15)


def test_a_lidar_as_the_base_keeps_the_covariances():
    left = RigidTransform.from_xyz_rpy("top", "left", [0.1, 0.6, 1.7], [0.2, 0.5, -1.5])
    rear = RigidTransform.from_xyz_rpy("top", "rear", [-2.0, 0.1, 1.1], [-0.1, 0.3, 3.0])
    rig = Extrinsics("top", {"left": left, "rear": rear}, covariances={"left": _covariance(1), "rear": _covariance(2)})
    from_left = rig.seen_from(left.inverse())
    assert {*from_left.covariances} == {"rear", "top"}
    for name in ("rear", "top"):
        expected = rig.covariance_between("left", name)
        np.testing.assert_allclose(from_left.covariance_between("left", name), expected, atol=1e-15)
    bare = Extrinsics("top", {"left": left, "rear": rear}, covariances={"rear": _covariance(2)})
    assert bare.seen_from(left.inverse()).covariances == {}


def test_covariances_between_lidars_are_of_both_motions():
    left = RigidTransform.from_xyz_rpy("top", "left", [0.1, 0.6, 1.7], [0.2, 0.5, -1.5])
    rear = RigidTransform.from_xyz_rpy("top", "rear", [-2.0, 0.1, 1.1], [-0.1, 0.3, 3.0])
    rig = Extrinsics("top", {"left": left, "rear": rear}, covariances={"left": _covariance(1), "rear": _covariance(2)})

    def offset(motions):
        one, other = moved(left, motions[:3], motions[3:6]), moved(rear, motions[6:9], motions[9:])
        return (one.inverse() @ other).offset_from(left.inverse() @ rear)

    step = 1e-5
    jacobian = np.stack([(offset(each) - offset(-each)) / (2.0 * step) for each in step * np.eye(12)], axis=-1)
    both = np.zeros((12, 12))
    both[:6, :6], both[6:, 6:] = _covariance(1), _covariance(2)
    found = rig.covariance_between("left", "rear")
    size = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    np.testing.assert_allclose(jacobian @ both @ jacobian.T / size, found / size, atol=1e-6)


def test_the_pose_between_two_lidars_is_that_of_both():
    left = RigidTransform.from_xyz_rpy("base", "left", [0.1, 0.6, 1.7], [0.2, 0.5, -1.5])
    rear = RigidTransform.from_xyz_rpy("base", "rear", [-2.0, 0.1, 1.1], [-0.1, 0.3, 3.0])
    rig = Extrinsics("base", {"left": left, "rear": rear})
    assert rig.members == {"base", "left", "rear"}
    expected = np.linalg.inv(left.matrix) @ rear.matrix
    np.testing.assert_allclose(rig.between("left", "rear").matrix, expected, atol=1e-12)
    np.testing.assert_allclose(rig.between("base", "rear").matrix, rear.matrix, atol=1e-12)
    np.testing.assert_allclose(rig.between("rear", "base").matrix, np.linalg.inv(rear.matrix), atol=1e-12)
    with pytest.raises(UnknownNameError, match="front"):
        rig.between("base", "front")


def test_only_joints_between_two_frames_count():
    poses = {name: RigidTransform.identity("base", name) for name in ("a", "b", "c")}
    wheel = "'steering', a revolute joint"
    found = Extrinsics("base", poses, {"a": frozenset({wheel}), "b": frozenset({wheel})})
    assert found.between("a", "b").source == "b"
    twice = Extrinsics("base", poses, {"a": frozenset({wheel, "'mast', a prismatic joint"})})
    with pytest.raises(InputError, match="through 'mast', a prismatic joint; expected"):
        twice.between("base", "a")
    for target, source in (("base", "a"), ("c", "b"), ("a", "base")):
        with pytest.raises(InputError, match="through 'steering', a revolute joint; expected fixed joints only"):
            found.between(target, source)


@pytest.mark.parametrize("axis", range(3))
def test_millimetres_are_told_by_lidar_and_target(axis):
    for length_m in (100.0, -100.0):
        require_metres(RigidTransform.from_xyz_rpy("base", "left", np.eye(3)[axis] * length_m, [0.0] * 3), "It")
    far = RigidTransform.from_xyz_rpy("base", "left", np.eye(3)[axis] * -101.0, [0.0] * 3)
    with pytest.raises(InputError, match=r"^The rig file has 'left' at .*-101\.0.* in 'base'; expected metres\.$"):
        require_metres(far, "The rig file")
