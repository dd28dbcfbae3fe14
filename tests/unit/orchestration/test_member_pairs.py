# SPDX-License-Identifier: Apache-2.0
"""Fits between the members of groups."""

from dataclasses import replace

import numpy as np
import pytest

from multilica.config import CalibrationConfig, with_overrides
from multilica.geometry import RigidTransform
from multilica.orchestration import member_pairs
from multilica.orchestration.member_pairs import fit_members
from multilica.orchestration.pairs import prepare_lidar
from multilica.pipeline import calibrate
from multilica.registration.plane_fit import PlaneFit
from multilica.results import Group
from multilica.simulate import simulate_snapshot
from tests.unit.made_pairs import pair
from tests.unit.made_rooms import HALL, scan

_CONFIG = CalibrationConfig()
_PLACES = {
    "a": RigidTransform.from_xyz_rpy("world", "a", [-1.0, 0.0, 1.8], [0.03, 0.1, 0.4]),
    "b": RigidTransform.from_xyz_rpy("world", "b", [1.0, 0.8, 1.6], [-0.1, 0.2, -1.2]),
    "c": RigidTransform.from_xyz_rpy("world", "c", [0.0, -0.9, 1.7], [0.1, 0.0, 2.0]),
}


@pytest.fixture(scope="module")
def lidars():
    clouds = [scan(name, place, HALL, seed=seed) for seed, (name, place) in enumerate(_PLACES.items())]
    return {cloud.lidar: prepare_lidar(cloud, _CONFIG) for cloud in clouds}


def _between(target, source):
    return _PLACES[target].inverse() @ _PLACES[source]


def _merge(nudge_m=(0.0, 0.0, 0.0)):
    """Of the group of `a` and `b` with `c`."""
    pose = _between("a", "c")
    nudged = RigidTransform.from_rotation_translation("a", "c", pose.rotation, pose.xyz_m + nudge_m)
    return replace(pair(nudged), information=np.eye(6))


_GROUP = Group("a", {"a": RigidTransform.identity("a", "a"), "b": _between("a", "b")})


def test_each_member_is_fitted_at_the_pose_of_the_groups(lidars):
    found = fit_members(_merge((0.02, -0.01, 0.01)), _GROUP, Group.of_one("c"), lidars, _CONFIG.refine)
    assert [(pair.target, pair.source) for pair in found] == [("a", "c"), ("b", "c")]
    for each in found:
        metres, radians = each.T_target_source.distance_to(_between(each.target, each.source))
        assert metres < 0.005
        assert radians < np.deg2rad(0.05)
        assert np.sqrt(np.linalg.inv(each.information)[3:, 3:].trace()) < 0.05
        assert len(each.bias_information.target_rings) > 10


def test_single_lidars_keep_their_registration(lidars):
    merge = _merge()
    assert fit_members(merge, Group.of_one("a"), Group.of_one("c"), lidars, _CONFIG.refine) == (merge,)


def test_members_that_do_not_meet_leave_the_registration(lidars):
    merge = _merge((0.0, 0.0, 80.0))
    assert fit_members(merge, _GROUP, Group.of_one("c"), lidars, _CONFIG.refine) == (merge,)


def test_fits_that_all_end_elsewhere_correct_the_pose(lidars):
    found = fit_members(_merge((0.08, 0.0, 0.0)), _GROUP, Group.of_one("c"), lidars, _CONFIG.refine)
    assert [(pair.target, pair.source) for pair in found] == [("a", "c"), ("b", "c")]
    for each in found:
        assert each.T_target_source.distance_to(_between(each.target, each.source))[0] < 0.005


def test_a_fit_that_alone_ends_elsewhere_is_left_out(lidars, monkeypatch):
    def fitted(target, _source, pose, _sigmas):
        off_m = 0.08 if target.name == "b" else 0.01
        shifted = RigidTransform.from_rotation_translation(
            pose.target, pose.source, pose.rotation, pose.xyz_m + np.array([off_m, 0.0, 0.0])
        )
        return PlaneFit(shifted, np.eye(6), object())

    monkeypatch.setattr(member_pairs, "fit_planes", fitted)
    found = fit_members(_merge(), _GROUP, Group.of_one("c"), lidars, _CONFIG.refine)
    assert [(pair.target, pair.source) for pair in found] == [("a", "c")]


@pytest.mark.in_turn
@pytest.mark.slow
def test_a_merge_whose_target_joins_counts_as_its_members():
    """The group of the target LiDAR is the source of its merge here."""
    made = simulate_snapshot("chain", "parking", 3211, build_seed=3201, sensors="real")
    config = with_overrides(_CONFIG, ["target=front_left", "runtime.workers=1"])
    trusted = calibrate(made.snapshot, config).trusted
    assert {name for pair in trusted for name in pair.lidars} == {*made.snapshot.names}
    assert all(pair.bias_information is not None for pair in trusted)
