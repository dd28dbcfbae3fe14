# SPDX-License-Identifier: Apache-2.0
"""Poses of LiDARs that links leave open in some direction, or that no chain of links tells."""

import numpy as np
import pytest

from multilica.config import RefineConfig
from multilica.geometry import RigidTransform
from multilica.multi_snapshot.common_ground import ground_pairs
from multilica.multi_snapshot.trusted_links import refine_linked
from multilica.multi_snapshot.view_solution import solve_views
from tests.multi_snapshot.made_drive import LIDARS, STOPS, pairs

_OVER_GROUND = RigidTransform.from_xyz_rpy("ground", "A", [0.0, 0.0, 1.8], [0.01, -0.02, 0.0])
_LEVELS = {name: _OVER_GROUND @ pose for name, pose in LIDARS.items()}
# A, B and C look in different directions: each link is between two of them, and only all together tell the poses.
_CROSSED = "B1-C3 A2-C3 A3-B2 A3-C4 B1-A2 B2-C4"
_CLOSING = "B3-A4 A1-C2"


def _refined(text, against=None, levels=None):
    return refine_linked("A", dict.fromkeys(STOPS, ()), _links(text), RefineConfig(), against, levels=levels or {})


def _links(text):
    return pairs(text, np.random.default_rng(1))


def test_links_that_form_no_chain_tell_the_poses_together():
    solution = solve_views("A", _links(f"{_CROSSED} {_CLOSING}"), ground_pairs(_LEVELS))
    covariance = solution.covariance
    for number, name in enumerate(solution.poses.free):
        block = slice(6 * number, 6 * number + 6)
        error = solution.poses.poses[name].offset_from(LIDARS[name])
        assert np.linalg.norm(error[3:]) < 1.0
        assert error @ np.linalg.solve(covariance[block, block], error) < 30.0
    assert solution.poses.free == ["B", "C"]


def test_a_pose_that_links_leave_open_has_a_wide_covariance():
    rig = _refined(_CROSSED).rig
    for name in rig.poses.keys() - {"A"}:
        error = rig.poses[name].offset_from(LIDARS[name])
        assert np.sqrt(np.linalg.eigvalsh(rig.covariances[name][3:, 3:])[-1]) > 3.0
        assert error @ np.linalg.solve(rig.covariances[name], error) < 30.0


def test_beams_do_not_test_a_pose_that_is_open():
    tested = []
    _refined(_CROSSED, lambda pose, _: tested.append((pose.target, pose.source)) or "")
    assert not tested


def test_beams_test_a_pose_that_is_told():
    tested = []
    _refined("A1-A2 A2-A3 A1-A3 A1-B3 A3-B1 A2-B3", lambda pose, _: tested.append((pose.target, pose.source)) or "")
    assert tested == [("A", "B")]


@pytest.mark.parametrize("seen", ["ABC", "BC"])
def test_the_ground_tells_height_roll_and_pitch(seen):
    levels = {name: _LEVELS[name] for name in seen}
    target, *_ = seen
    for pair in ground_pairs(levels):
        offset = (LIDARS[target].inverse() @ LIDARS[pair.source.lidar]).offset_from(pair.registration.T_target_source)
        information = np.asarray(pair.registration.information)
        assert offset @ information @ offset < 1e-9
        assert np.linalg.matrix_rank(information) == 3
    assert [pair.source.lidar for pair in ground_pairs(levels)] == [*seen[1:]]


def test_without_ground_in_sight_there_are_no_such_pairs():
    assert ground_pairs({}) == []
    assert ground_pairs({"A": _LEVELS["A"]}) == []


def test_a_pose_that_only_the_ground_completes_is_told_so():
    """Each LiDAR alone: its turns tell all but the height."""
    every = "A1-A2 A2-A3 A1-A3 B1-B2 B2-B3 B1-B3"
    flat = {
        name: RigidTransform.from_xyz_rpy("A", "A", pose.xyz_m * [1, 1, 0], [0, 0, 0.9 * number])
        for number, (name, pose) in enumerate(STOPS.items())
    }
    links = pairs(every, np.random.default_rng(2), stops=flat)
    found = refine_linked("A", dict.fromkeys(STOPS, ()), links, RefineConfig(), levels=_LEVELS)
    told = found.by_motions["B"]
    error = told.T_root_lidar.offset_from(LIDARS["B"])
    assert error @ np.linalg.solve(told.covariance, error) < 20.0
    assert np.sqrt(np.linalg.eigvalsh(told.covariance[3:, 3:])[-1]) < 0.3
