# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from multilica.geometry import RigidTransform, fixed_sign, largest_index, read_only, rotation_vector, skew

_coordinate = st.floats(-100.0, 100.0)
_angle = st.floats(-np.pi, np.pi)
_upright = st.floats(0.0, 1e-6).map(lambda angle: np.pi / 2 - angle)
_pitch = st.floats(-np.pi / 2, np.pi / 2) | _upright | _upright.map(lambda angle: -angle)
_xyz = st.tuples(_coordinate, _coordinate, _coordinate)
_rpy = st.tuples(_angle, _pitch, _angle)


def _pose(xyz_m, rpy_rad, target="a", source="b"):
    return RigidTransform.from_xyz_rpy(target, source, xyz_m, rpy_rad)


@given(_xyz, _rpy)
def test_inverse_undoes(xyz_m, rpy_rad):
    pose = _pose(xyz_m, rpy_rad)
    assert np.allclose((pose @ pose.inverse()).matrix, np.eye(4), atol=1e-9)
    assert (pose.inverse().target, pose.inverse().source) == ("b", "a")


@pytest.mark.slow
@given(_xyz, _rpy, _xyz, _rpy, _xyz)
def test_product_applies_right_to_left(xyz_1, rpy_1, xyz_2, rpy_2, point):
    T_a_b, T_b_c = _pose(xyz_1, rpy_1), _pose(xyz_2, rpy_2, "b", "c")
    points = np.array([point])
    assert np.allclose((T_a_b @ T_b_c).apply(points), T_a_b.apply(T_b_c.apply(points)), atol=1e-8)


@given(_xyz, _rpy)
def test_angles_and_quaternion_round_trip(xyz_m, rpy_rad):
    pose = _pose(xyz_m, rpy_rad)
    assert np.allclose(_pose(pose.xyz_m, pose.rpy_rad).matrix, pose.matrix, atol=1e-9)
    again = RigidTransform.from_xyz_quaternion("a", "b", pose.xyz_m, pose.quaternion_xyzw)
    assert np.allclose(again.matrix, pose.matrix, atol=1e-9)


def test_rpy_is_extrinsic_xyz():
    roll, pitch, yaw = 0.1, 0.2, 0.3
    x_turn = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
    y_turn = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
    z_turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    assert np.allclose(_pose([0, 0, 0], [roll, pitch, yaw]).rotation, z_turn @ y_turn @ x_turn)


@given(st.floats(1e-9, 3.0))
def test_distance_keeps_small_angles(angle_rad):
    _, measured_rad = _pose([0, 0, 0], [0, 0, angle_rad]).distance_to(RigidTransform.identity("a", "b"))
    assert measured_rad == pytest.approx(angle_rad, rel=1e-6, abs=1e-12)


@pytest.mark.slow
@given(_xyz, _rpy, _xyz, _rpy)
def test_an_offset_leads_from_one_pose_to_the_other(xyz_1, rpy_1, xyz_2, rpy_2):
    one, other = _pose(xyz_1, rpy_1), _pose(xyz_2, rpy_2)
    offset = one.offset_from(other)
    turned = Rotation.from_rotvec(offset[:3]).as_matrix() @ other.rotation
    assert np.allclose(turned, one.rotation, atol=1e-9)
    assert np.allclose(other.xyz_m + offset[3:], one.xyz_m, atol=1e-9)


@given(_rpy, st.floats(-14.0, 0.5), st.booleans())
def test_a_rotation_vector_is_that_of_scipy(rpy_rad, exponent, nearly_half):
    turn_rad = np.array(rpy_rad) * 10.0**exponent
    if nearly_half:
        turn_rad *= (np.pi - 10.0**exponent) / max(np.linalg.norm(turn_rad), 1e-20)
    turn = Rotation.from_rotvec(turn_rad)
    np.testing.assert_allclose(rotation_vector(turn.as_matrix()), turn.as_rotvec(), rtol=1e-6, atol=1e-12)


@given(_xyz, _xyz)
def test_skew_is_the_cross_product(a, b):
    assert np.allclose(skew(np.array(a)) @ np.array(b), np.cross(a, b))


def test_chains_only_through_the_same_frame():
    with pytest.raises(ValueError, match="'b' is not 'c'"):
        _pose([0, 0, 0], [0, 0, 0]) @ _pose([0, 0, 0], [0, 0, 0], "c", "d")


@pytest.mark.parametrize(
    "matrix",
    [
        np.eye(3),
        np.full((4, 4), np.nan),
        np.diag([1.0, 1.0, 1.0, 2.0]),
        *(np.diag([*np.roll([1.0, 1.0, size], axis), 1.0]) for axis in range(3) for size in (-1.0, 1.0 + 1e-5)),
        *(np.eye(4) + 1e-5 * np.eye(4)[:, [place]] * np.eye(4)[(place + 1) % 3] for place in range(3)),
        np.diag([1e200, -1e200, 1.0, 1.0]),
        np.array([[1e200, 1e200, 0, 0], [1e200, -1e200, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]),
    ],
)
def test_refuses_what_is_no_rigid_transform(matrix):
    with pytest.raises(ValueError, match="expected"):
        RigidTransform("a", "b", matrix)


def test_the_matrix_cannot_be_written_to():
    with pytest.raises(ValueError, match="read-only"):
        RigidTransform.identity("a", "b").matrix[0, 0] = 2.0


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("rounding_rad", [-1e-12, 0.0, 1e-12])
def test_a_half_turn_is_written_the_same_despite_rounding(axis, rounding_rad):
    turned = Rotation.from_rotvec((np.pi + rounding_rad) * np.eye(3)[axis]).as_matrix()
    pose = RigidTransform.from_rotation_translation("a", "b", turned, np.zeros(3))
    assert pose.quaternion_xyzw == pytest.approx([*np.eye(3)[axis], 0.0], abs=1e-9)
    about_z_or_x = pose.rpy_rad[[0, 2]]
    assert np.all((np.abs(about_z_or_x) < 1e-9) | (np.abs(about_z_or_x - np.pi) < 1e-9))


@pytest.mark.parametrize("rounding", [-1e-15, 0.0, 1e-15])
def test_of_equal_components_the_first_counts(rounding):
    direction = np.array([0.1, -0.5 - rounding, 0.5])
    assert largest_index(direction) == 1
    assert fixed_sign(direction) == pytest.approx([-0.1, 0.5, -0.5])
    assert fixed_sign(-direction) == pytest.approx([-0.1, 0.5, -0.5])
    assert largest_index(np.array([0.5, 0.6])) == 1


@pytest.mark.parametrize("pitch_rad", [np.pi / 2, -np.pi / 2])
def test_angles_are_known_where_roll_and_yaw_have_one_axis(pitch_rad):
    pose = _pose([0, 0, 0], [0.4, pitch_rad, 0.7])
    assert np.allclose(_pose([0, 0, 0], pose.rpy_rad).matrix, pose.matrix, atol=1e-7)
    assert pose.rpy_rad[2] == 0.0


def test_angles_are_told_in_degrees():
    assert _pose([0, 0, 0], np.deg2rad([10.0, -20.0, 30.0])).rpy_deg == pytest.approx([10.0, -20.0, 30.0])


def test_a_frame_of_neither_side_is_refused_by_name():
    with pytest.raises(ValueError, match="T_a_b has no frame 'c'"):
        RigidTransform.identity("a", "b").with_target("c")


def test_only_what_may_change_or_has_another_order_is_copied():
    whole = np.arange(12.0).reshape(3, 4)
    frozen = read_only(whole, np.float64)
    assert frozen is not whole
    assert read_only(frozen, np.float64) is frozen
    with pytest.raises(ValueError, match="read-only"):
        frozen[0, 0] = 1.0
    across = whole.copy(order="F")
    across.setflags(write=False)
    view = whole[:2]
    view.setflags(write=False)
    for array in (across, view):
        copy = read_only(array, np.float64)
        assert copy is not array
        assert copy.flags.c_contiguous
        assert np.array_equal(copy, array)
    assert read_only(frozen, np.float32).dtype == np.float32
