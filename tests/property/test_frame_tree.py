# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from multilica.geometry import RigidTransform
from multilica.ingest.transforms import Joint, poses_from

_number = st.floats(-3.0, 3.0)
_six = st.tuples(_number, _number, _number, _number, _number, _number)


@st.composite
def _trees(draw):
    """Joints of a random tree in random order, with the pose of every frame in the root."""
    poses = {"0": RigidTransform.identity("0", "0")}
    joints = []
    for child in range(1, draw(st.integers(2, 8))):
        parent = str(draw(st.integers(0, child - 1)))
        numbers = draw(_six)
        step = RigidTransform.from_xyz_rpy(parent, str(child), numbers[:3], numbers[3:])
        poses[str(child)] = poses[parent] @ step
        joints.append(Joint(step, f"joint {child}", draw(st.sampled_from(["fixed", "fixed", "revolute"]))))
    return draw(st.permutations(joints)), poses


@pytest.mark.slow
@given(_trees())
def test_every_frame_sees_every_other_where_the_root_has_them(made):
    joints, poses = made
    for target, T_root_target in poses.items():
        seen = poses_from(target, joints)
        assert set(seen) == set(poses)
        for source, sight in seen.items():
            pose = sight.T_target_source
            expected = T_root_target.inverse() @ poses[source]
            assert (pose.target, pose.source) == (target, source)
            assert np.allclose(pose.matrix, expected.matrix, atol=1e-9)


@pytest.mark.slow
@given(_trees())
def test_a_moving_joint_is_named_exactly_where_it_lies_between(made):
    joints, poses = made
    fixed = [joint for joint in joints if joint.kind == "fixed"]
    for target in poses:
        rigid = set(poses_from(target, fixed))
        for source, sight in poses_from(target, joints).items():
            assert (sight.moving is None) == (source in rigid)
            assert sight.moving is None or sight.moving.kind == "revolute"


def test_frames_that_nothing_joins_are_not_seen():
    joints = [Joint(RigidTransform.identity(parent, child)) for parent, child in (("a", "b"), ("c", "d"))]
    assert set(poses_from("b", joints)) == {"a", "b"}


def test_a_ring_of_joints_ends():
    joints = [Joint(RigidTransform.identity(parent, child)) for parent, child in (("a", "b"), ("b", "c"), ("c", "a"))]
    assert set(poses_from("a", joints)) == {"a", "b", "c"}
