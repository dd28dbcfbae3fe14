# SPDX-License-Identifier: Apache-2.0
import numpy as np

from multilica.geometry import RigidTransform
from multilica.registration.poses import within_baseline
from multilica.results import Registration, VisibilityScore


def _registration(*xyz_m):
    pose = RigidTransform.from_xyz_rpy("t", "s", xyz_m, [0.0, 0.0, 0.0])
    score = VisibilityScore(100, 0, 0, 0, np.eye(6), np.zeros(0, dtype=np.uint8))
    return Registration(0, pose, score, 0.5, 0.05, 1.0, np.zeros((0, 3)))


def test_poses_beyond_the_baseline_are_left_out():
    near, at_limit, far = _registration(3.0, 4.0, 0.0), _registration(0.0, 0.0, 15.0), _registration(9.0, 12.1, 0.0)
    assert within_baseline([far, near, at_limit], 15.0) == [near, at_limit]


def test_if_all_poses_are_too_far_all_stay():
    far, farther = _registration(20.0, 0.0, 0.0), _registration(30.0, 0.0, 0.0)
    assert within_baseline([farther, far], 15.0) == [farther, far]
    assert within_baseline([], 15.0) == []
