# SPDX-License-Identifier: Apache-2.0
"""Tables of extrinsics that people write."""

from __future__ import annotations

import numpy as np
import pytest

from multilica.errors import InputError, UnreadableSourceError
from multilica.extrinsics import EXTRINSICS_SCHEMA, Extrinsics, read_extrinsics
from multilica.geometry import RigidTransform

HEAD = f'schema = "{EXTRINSICS_SCHEMA}"\ntarget = "base"\n[lidars.left]\n'


def test_position_and_angles_are_enough(tmp_path):
    path = tmp_path / "drawing.toml"
    path.write_text(f"{HEAD}xyz_m = [0.1, 0.6, 1.7]\nrpy_deg = [0, 45, -90]\n")
    expected = RigidTransform.from_xyz_rpy("base", "left", [0.1, 0.6, 1.7], [0.0, np.pi / 4, -np.pi / 2])
    np.testing.assert_allclose(read_extrinsics(path).T_target_source["left"].matrix, expected.matrix, atol=1e-12)


@pytest.mark.parametrize(
    ("pose", "complaint"),
    [
        ("xyz_m = [0.1, 0.6, 1.7]", "it has no 'rpy_deg'"),
        ("rpy_deg = [0, 45, -90]", "it has no 'xyz_m'"),
        ("xyz_m = [0.1, 0.6]\nrpy_deg = [0, 45, -90]", "is not a table of extrinsics"),
        ('xyz_m = [0.1, 0.6, 1.7]\nrpy_deg = "up"', "is not a table of extrinsics"),
    ],
)
def test_half_a_pose_is_refused_in_a_sentence(tmp_path, pose, complaint):
    path = tmp_path / "drawing.toml"
    path.write_text(f"{HEAD}{pose}\n")
    with pytest.raises(UnreadableSourceError, match=complaint):
        read_extrinsics(path)


def test_only_joints_between_two_frames_count():
    poses = {name: RigidTransform.identity("base", name) for name in ("a", "b", "c")}
    wheel = "'steering', a revolute joint"
    found = Extrinsics("base", poses, {"a": frozenset({wheel}), "b": frozenset({wheel})})
    assert found.between("a", "b").source == "b"
    for target, source in (("base", "a"), ("c", "b"), ("a", "base")):
        with pytest.raises(InputError, match="through 'steering', a revolute joint; expected fixed joints only"):
            found.between(target, source)
