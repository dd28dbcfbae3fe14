# SPDX-License-Identifier: Apache-2.0
"""The measurement of drives tells wrong poses, links and knocks from right ones."""

from __future__ import annotations

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.results import Knock, LidarPlacement, PairRegistration, Verdict, ViewPair
from multilica.simulate import RIGS, ROUTES, SCENES, simulate_drive
from tests.bench.drives import drives
from tests.bench.drives.cases import BESIDE_HAND_EYE, KNOCK, STRAIGHT, TURNING, drives_of
from tests.bench.drives.outcomes import DriveOutcome, LidarOutcome, LinkOutcome, link_outcome, offset_of
from tests.bench.drives.ways import in_plane_mm

_TURNING, _KNOCKED, _STRAIGHT, _LOGGED = (
    next(drives_of(rows[0], 1, 5000)) for rows in (TURNING, KNOCK, STRAIGHT, BESIDE_HAND_EYE)
)


def _lidar(status="placed", off_m=0.0, off_deg=0.0, distance=1.0) -> LidarOutcome:
    return LidarOutcome("rear", status, np.array([np.deg2rad(off_deg), 0.0, 0.0, off_m, 0.0, 0.0]), distance)


_RIGHT, _NOWHERE = _lidar(), LidarOutcome("rear", "not_placed")
_LINK = LinkOutcome("rear at stop 1 - front at stop 2", 1.0, 0.0)
_HIT = Knock("rear", "stop 2", "stop 3", 0.02, 0.0, ("stop 1", "stop 2"))


def _drive(*lidars, case=_TURNING, **values) -> DriveOutcome:
    found = DriveOutcome(case, "front", lidars or (_RIGHT,), 4, (), (), "rear" if case.row.knock else "", 8.0, 2.0)
    return replace(found, **values)


@pytest.mark.parametrize(
    ("lidar", "right", "wrong", "beyond"),
    [
        (_lidar(off_m=0.019, off_deg=0.19), True, False, False),
        (_lidar(off_m=0.03), False, False, False),
        (_lidar(off_deg=0.3), False, False, False),
        (_lidar(off_m=0.06), False, True, False),
        (_lidar(off_deg=0.6, distance=9.0), False, True, True),
        (_lidar("uncertain", off_m=0.9), False, False, False),
        (_NOWHERE, False, False, False),
    ],
)
def test_only_a_placed_lidar_is_right_or_wrong(lidar, right, wrong, beyond):
    assert (lidar.right, lidar.wrong, lidar.beyond) == (right, wrong, beyond)


@pytest.mark.parametrize(
    ("found", "failing"),
    [
        ([_drive()] * 20, []),
        ([_drive(_RIGHT)] * 19 + [_drive(_lidar("uncertain", 0.1))], []),
        ([_drive(_RIGHT)] * 16 + [_drive(_lidar("uncertain", 0.1))] * 4, ["no common view, turning: placed"]),
        ([_drive(_RIGHT)] * 18 + [_drive(_NOWHERE)] * 2, ["no common view, turning: within 2 cm"]),
        ([_drive(_RIGHT)] * 19 + [_drive(_lidar(off_m=0.06))], ["placed, but over 5 cm"]),
        ([_drive(_RIGHT)] * 19 + [_drive(_lidar(distance=9.0))], ["placed or uncertain beyond"]),
        ([_drive()] * 19 + [_drive(wrong_links=(_LINK,))], ["links used that are over"]),
        ([_drive()] * 19 + [_drive(knocks=(_HIT,))], ["drives with a knock that was none"]),
        ([_drive(case=_KNOCKED, knocks=(_HIT,))] * 19 + [_drive(case=_KNOCKED)], []),
        ([_drive(case=_KNOCKED, knocks=(_HIT,))] * 18 + [_drive(case=_KNOCKED)] * 2, ["knocks of 2 cm named"]),
        ([_drive(case=_KNOCKED, knocks=(replace(_HIT, after="stop 4"),))], ["knocks of 2 cm named"]),
        ([_drive(case=_STRAIGHT)] * 8 + [_drive(_NOWHERE, case=_STRAIGHT)] * 2, []),
        ([_drive(case=_STRAIGHT)] * 7 + [_drive(_NOWHERE, case=_STRAIGHT)] * 3, ["no common view, straight"]),
        ([_drive(replace(_RIGHT, in_plane_mm=(3.0, 40.0)), case=_LOGGED)], []),
        ([_drive(replace(_RIGHT, in_plane_mm=(5.0, 4.0)), case=_LOGGED)], ["front_back: median error in the plane"]),
    ],
)
def test_each_claim_on_drives_can_fail(found, failing):
    told = [claim.measure for claim in drives.claims(found) if not claim.holds]
    assert len(told) == len(failing)
    assert all(measure.startswith(words) for measure, words in zip(told, failing, strict=True))


def test_a_link_is_compared_with_the_true_poses():
    made = simulate_drive("front_back", "street", 5, stops=2, frames=1, sensors="ideal", keep_every=50)
    truth = made.truth.T_target_source
    pose = truth["front"].inverse() @ RigidTransform("base", "base", made.T_first_stop_base[1].matrix) @ truth["rear"]
    shifted = RigidTransform.from_xyz_rpy("rear", "rear", (0.0, 0.4, 0.0), (0.0, 0.0, 0.0))
    for link, off_m, wrong in ((pose, 0.0, False), (pose @ shifted, 0.4, True)):
        pair = PairRegistration("front", "rear", link, 0.9, 0.01, 9, None, None, "", verdict=Verdict("accept"))
        found = link_outcome(made, ViewPair(pair, "stop 1", "stop 2"))
        assert found.off_m == pytest.approx(off_m, abs=1e-6)
        assert found.wrong is wrong


@pytest.mark.parametrize(
    ("lidar", "left_out", "off_m"),
    [("rear", (), 0.0), ("rear", ("stop 1", "stop 2"), 0.02), ("front", ("stop 1", "stop 2"), 0.02)],
)
def test_a_knocked_lidar_is_compared_with_the_stops_that_count(lidar, left_out, off_m):
    before = RigidTransform.from_xyz_rpy("front", "rear", (-3.0, 0.0, 0.0), (0.0, 0.0, np.pi))
    after = RigidTransform.from_xyz_rpy("front", "rear", (-3.0, 0.02, 0.0), (0.0, 0.0, np.pi))
    truths = [Extrinsics("front", {"rear": pose}) for pose in (before, before, after)]
    knocks = [replace(_HIT, lidar=lidar, left_out=left_out)]
    placement = LidarPlacement("rear", "placed", "placed", before, covariance=1e-4 * np.eye(6))
    offset = offset_of(placement, "front", truths, knocks)
    assert np.linalg.norm(offset[3:]) == pytest.approx(off_m, abs=1e-9)


def test_an_error_in_the_plane_has_no_height():
    made = simulate_drive("front_back", "street", 5, stops=2, frames=1, sensors="ideal", keep_every=50)
    T_front_base = made.truth.T_target_source["front"].inverse()
    offset_m = T_front_base.rotate(np.array([[0.03, 0.04, 2.0]]))[0]
    assert in_plane_mm(made, "front", offset_m) == pytest.approx(50.0)


def test_each_row_has_drives_that_can_be_simulated(monkeypatch, capsys):
    asked = []
    monkeypatch.setattr(drives, "run_all", lambda _, tasks: asked.extend(tasks) or [])
    assert drives.main(7)
    assert capsys.readouterr().out.count("\n| ") >= len(drives.ROWS)
    assert len(asked) == 7 * len(drives.ROWS)
    for case in asked:
        assert case.rig in RIGS
        assert case.scene in SCENES
        assert case.route in ROUTES
        assert len(RIGS[case.rig].mounts) > 2 or not case.row.knock
    assert {case.stops for case in islice(asked, 7)} == {3, 4}
