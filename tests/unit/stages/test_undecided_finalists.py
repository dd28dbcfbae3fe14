# SPDX-License-Identifier: Apache-2.0
"""Finalists of which several are equally likely take no further registration."""

from __future__ import annotations

from dataclasses import replace

import pytest

from multilica.acceptance.accept import accept, surely_competing
from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.registration.gicp import register
from multilica.results import Hypothesis
from multilica.stages import fine
from multilica.stages.fine import leads_surely, register_best
from multilica.visibility.registration_cloud import prepare_registration_cloud
from multilica.visibility.sensor_view import prepare_sensor_view
from tests.unit.made_rooms import AISLE, AISLE_PERIOD_M, scan

_CONFIG = CalibrationConfig()
_TARGET = RigidTransform.from_xyz_rpy("world", "t", [-1.0, 0.0, 1.8], [0.0, 0.0, 0.0])
_SOURCE = RigidTransform.from_xyz_rpy("world", "s", [1.0, 0.8, 1.6], [0.0, 0.0, 0.3])
_TRUTH = _TARGET.inverse() @ _SOURCE


@pytest.fixture(scope="module")
def sides():
    clouds = scan("t", _TARGET, AISLE, columns=720), scan("s", _SOURCE, AISLE, seed=1)
    return tuple(_thinned(each) for each in clouds)


def _thinned(cloud):
    view = (RigidTransform.identity(cloud.lidar, cloud.lidar), prepare_sensor_view(cloud))
    side = prepare_registration_cloud(cloud.lidar, cloud.points_m, [view], _CONFIG)
    return replace(side, finalist_gicp=_CONFIG.fine.model_copy(update={"max_points": 2000}))


def _starts(*periods, off_m=0.05):
    moved = [RigidTransform.from_xyz_rpy("t", "t", (n * AISLE_PERIOD_M + off_m, 0, 0), (0, 0, 0)) for n in periods]
    return [Hypothesis(each @ _TRUTH, index=index) for index, each in enumerate(moved)]


@pytest.fixture
def registered(monkeypatch):
    """The numbers of source points with which GICP runs."""
    points = []

    def counted(target, source, *rest):
        points.append(len(source.points_m))
        return register(target, source, *rest)

    monkeypatch.setattr(fine, "register", counted)
    return points


def test_equal_poses_end_the_registration(sides, registered, monkeypatch):
    found = register_best(*sides, _starts(0, -1, -2), _CONFIG)
    assert accept(found.registrations, _CONFIG.acceptance).outcome == "undecided"
    assert len(surely_competing(found.registrations, _CONFIG.acceptance)) == 2
    assert max(registered) <= 2000
    assert found.registrations[0].stability is None
    monkeypatch.setattr(fine, "_SLIDE_POSES", 3)
    further = register_best(*sides, _starts(0, -1, -2), _CONFIG)
    assert accept(further.registrations, _CONFIG.acceptance).outcome == "undecided"
    assert max(registered) > 2000


def test_one_equal_pose_does_not_end_the_registration(sides, registered):
    found = register_best(*sides, _starts(0, -1), _CONFIG)
    assert len(surely_competing(found.registrations, _CONFIG.acceptance)) == 1
    assert max(registered) > 2000


def test_only_the_best_goes_on_if_others_compete_with_it(sides, registered, monkeypatch):
    sides = [replace(side, finalist_gicp=side.finalist_gicp.model_copy(update={"max_iterations": 1})) for side in sides]
    register_best(*sides, _starts(0, -1, -2), _CONFIG)
    begun = len(registered)
    monkeypatch.setattr(fine, "_SLIDE_POSES", 3)
    registered.clear()
    register_best(*sides, _starts(0, -1, -2), _CONFIG)
    assert begun == 3 + 1
    assert len([points for points in registered if points <= 2000]) >= 3 + 3


def test_poses_near_the_best_may_still_end_there(sides):
    found = register_best(*sides, _starts(0, -1), _CONFIG).registrations
    shift = RigidTransform.from_xyz_rpy("t", "t", (0.6, 0.0, 0.0), (0.0, 0.0, 0.0))
    near = replace(found[1], T_target_source=shift @ found[0].T_target_source)
    assert surely_competing(found, _CONFIG.acceptance) == [found[1]]
    assert surely_competing([found[0], near], _CONFIG.acceptance) == []


def test_the_pose_that_leads_all_others_is_the_first(sides, monkeypatch):
    monkeypatch.setattr(fine, "likeliest_first", lambda found: sorted(found, key=lambda each: each.evidence))
    found = register_best(*sides, _starts(0, -1, -2), _CONFIG).registrations
    assert len(found) == 3
    assert found[0].evidence == min(each.evidence for each in found)


@pytest.mark.parametrize(
    ("starts", "leads"),
    [((0,), True), ((0, -1), False), ((0, 40), True), ((40, 0), False)],
    ids=["alone", "beside an equal pose", "beside a worse pose", "worse"],
)
def test_a_pose_that_surely_leads_needs_few_points(sides, registered, starts, leads):
    assert leads_surely(*sides, _starts(*starts), _CONFIG) is leads
    assert max(registered) <= 2000


def test_a_pose_that_moves_far_leads_nothing(sides):
    assert leads_surely(*sides, _starts(0, off_m=0.2), _CONFIG)
    assert not leads_surely(*sides, _starts(0, off_m=0.5), _CONFIG)
