# SPDX-License-Identifier: Apache-2.0
import numpy as np

from multilica import testimony
from multilica.geometry import RigidTransform
from multilica.results import Assessment
from multilica.stages.poses import within_reach


def _answer(*xyz_m):
    pose = RigidTransform.from_xyz_rpy("t", "s", xyz_m, [0.0, 0.0, 0.0])
    said = testimony.Testimony(100, 0, 0, 0, np.eye(6), np.zeros(0, dtype=np.uint8))
    return Assessment(0, pose, said, 0.5, 0.05, 1.0, np.zeros((0, 3)))


def test_answers_that_no_vehicle_is_long_enough_for_are_left_out():
    near, brim, far = _answer(3.0, 4.0, 0.0), _answer(0.0, 0.0, 15.0), _answer(9.0, 12.1, 0.0)
    assert within_reach([far, near, brim], 15.0) == [near, brim]


def test_where_all_are_too_far_none_is_left_out():
    far, farther = _answer(20.0, 0.0, 0.0), _answer(30.0, 0.0, 0.0)
    assert within_reach([farther, far], 15.0) == [farther, far]
    assert within_reach([], 15.0) == []
