# SPDX-License-Identifier: Apache-2.0
"""LiDARs that move on the vehicle between two stops, out of made registrations of views."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.multi_snapshot import SnapshotRun, join, knocks
from multilica.multi_snapshot.knocks import find_knock
from multilica.multi_snapshot.view_solution import solve_views
from multilica.results import CalibrationResult, DriveView, LidarPlacement
from tests.multi_snapshot.made_drive import STOPS, pairs, refined, split
from tests.selection import some_of

_EVERY = "A1-A2 A2-A3 A3-A4 A1-A3 A1-B3 A3-B1 A2-B4 A4-B2 B1-B2 B3-B4 A2-C2 A3-C3 A4-C4 C1-C2 A1-C1 B2-C4"


def _knocked(every, lidar, later, by_m=0.02):
    """Move a LiDAR at some stops."""
    off = RigidTransform.from_xyz_rpy(lidar, lidar, (by_m, 0.0, 0.0), (0.0, 0.0, 0.0))
    for each in every:
        pose = each.registration.T_target_source
        if each.source.lidar == lidar and each.source_stop in later:
            pose = pose @ off
        if each.target.lidar == lidar and each.target_stop in later:
            pose = off.inverse() @ pose
        yield replace(each, registration=replace(each.registration, T_target_source=pose))


@pytest.mark.parametrize("lidar", ["A", "B", "C"])
@pytest.mark.parametrize("seed", [10, pytest.param(11, marks=pytest.mark.nightly)])
def test_a_knock_between_stops_is_named_and_dated(lidar, seed):
    every = list(_knocked(pairs(_EVERY, np.random.default_rng(seed)), lidar, {"stop 4"}))
    (knock,) = refined(every).knocks
    assert (knock.lidar, knock.before, knock.after, knock.left_out) == (lidar, "stop 3", "stop 4", ("stop 4",))
    assert not knock.rivals
    assert knock.distance_m == pytest.approx(0.02, abs=0.008)


def test_a_stop_on_the_other_side_of_a_knock_is_an_outlier():
    every = list(_knocked(pairs(_EVERY, np.random.default_rng(10)), "C", {"stop 4"}))
    within, links = split(every)
    runs = [
        SnapshotRun(
            stop, CalibrationResult("A", "", tuple(LidarPlacement(each, "") for each in "ABC"), trusted=trusted)
        )
        for stop, trusted in within.items()
    ]
    found = join(runs, CalibrationConfig(target="A"), links=links)
    assert [knock.lidar for knock in found.knocks] == ["C"]
    assert [report.outliers for report in found.snapshots] == [(), (), (), ("C",)]


def test_a_knock_about_a_stop_without_views_is_dated_around_it():
    every = pairs(_EVERY, np.random.default_rng(10))
    seen = [each for each in every if DriveView("C", "stop 3") not in each.views]
    (knock,) = refined(list(_knocked(seen, "C", {"stop 4"}))).knocks
    assert (knock.lidar, knock.before, knock.after) == ("C", "stop 2", "stop 4")
    assert knock.left_out == ("stop 3", "stop 4")


@pytest.mark.parametrize(("missing", "is_told"), [("", True), ("A1-C1", False)])
def test_one_link_alone_tells_no_knock(missing, is_told):
    """It may just be wrong: then it is refused."""
    every = [each for each in _EVERY.split() if each != missing]
    moved = {"stop 2", "stop 3", "stop 4"}
    found = refined(list(_knocked(pairs(" ".join(every), np.random.default_rng(10)), "C", moved)))
    assert bool(found.knocks) == is_told
    refused = {(link.target, link.source): link.reason for link in found.links if not link.used}
    assert is_told or refused == {("C", "C"): "it contradicts other links and pairs"}


@pytest.mark.parametrize(("explained", "left_out"), [(55.0, ("stop 1", "stop 2")), (40.0, ("stop 1",))])
def test_a_time_that_one_link_tells_stays_possible(monkeypatch, explained, left_out):
    """The stop between both times may be on either side of the motion."""
    values = {"lidar": "B", "probability": 1e-9, "may_be_knock": True, "distance_m": 0.02, "angle_rad": 0.0}
    motions = [
        SimpleNamespace(number=1, explained=50.0, is_told=True, **values),
        SimpleNamespace(number=2, explained=explained, is_told=False, **values),
    ]
    monkeypatch.setattr(knocks, "_motions", lambda *_: motions)
    stops = [f"stop {number}" for number in range(1, 5)]
    assert find_knock("A", SimpleNamespace(squared=100.0), stops).left_out == left_out


@pytest.mark.parametrize(("explained", "is_named"), [(45.0, False), (40.0, True)])
def test_what_may_be_the_error_of_another_view_is_no_knock(monkeypatch, explained, is_named):
    values = {"number": 2, "probability": 1e-9, "may_be_knock": True, "distance_m": 0.02, "angle_rad": 0.0}
    motions = [
        SimpleNamespace(lidar="B", explained=50.0, is_told=True, **values),
        SimpleNamespace(lidar="C", explained=explained, is_told=False, **values),
    ]
    monkeypatch.setattr(knocks, "_motions", lambda *_: motions)
    found = find_knock("A", SimpleNamespace(squared=100.0), [f"stop {number}" for number in range(1, 5)])
    assert (found is not None) == is_named


@pytest.mark.parametrize("lidar", ["A", "B", "C"])
def test_a_knock_that_chance_may_explain_is_a_possible_one(lidar):
    found = refined(list(_knocked(pairs(_EVERY, np.random.default_rng(10)), lidar, {"stop 4"}, 0.008)))
    assert not found.knocks
    knock = found.possible_knock
    assert (knock.lidar, knock.before, knock.after) == (lidar, "stop 3", "stop 4")
    assert knock.distance_m == pytest.approx(0.008, abs=0.002)
    moved_m = {name: np.linalg.norm(offset[3:]) for name, offset in knock.offsets.items()}
    assert 0.004 < max(moved_m.values()) < 0.009
    assert lidar == "A" or max(moved_m, key=moved_m.get) == lidar


@pytest.mark.parametrize(("later", "is_knock"), [({"stop 3", "stop 4"}, True), ({"stop 4"}, False)])
@pytest.mark.parametrize(("seed", "by_m"), [(10, 0.02), (11, 0.012)])
def test_what_one_view_alone_tells_is_a_possible_knock(later, is_knock, seed, by_m):
    """Six pairs share the errors of B at stop 4. A motion of A, with fewer pairs there, explains as much."""
    text = "A1-A2 A2-A3 A3-A4 A1-A3 A1-B1 A2-B2 A3-B3 B1-B2 B2-B3 B1-B3 A4-B4 A2-B4 A3-B4 A1-B4 B3-B4 B2-B4"
    found = refined(list(_knocked(pairs(text, np.random.default_rng(seed)), "B", later, by_m)))
    assert [(knock.lidar, knock.rivals) for knock in found.knocks] == [("B", ("A",))] * is_knock
    assert is_knock or found.possible_knock.before == "stop 3"


@pytest.mark.parametrize("root", ["A", "B"])
def test_sigma_covers_a_possible_knock(root):
    other = "B" if root == "A" else "A"
    links = pairs("A1-A2 A2-A3 A3-A4 A1-A3 A1-B3 A3-B1 A2-B4 A4-B2 A4-B3 B1-B2 B3-B4", np.random.default_rng(10))
    links = list(_knocked(links, "B", {"stop 4"}, 0.01))
    found = refined(links, root)
    knock = found.possible_knock
    alone = CalibrationResult("A", "", tuple(LidarPlacement(name, "nothing in common") for name in "AB"))
    placed = join([SnapshotRun(stop, alone) for stop in STOPS], CalibrationConfig(target=root), links=links)[other]
    assert placed.reason.endswith(" may have moved by 10 mm between stop 3 and stop 4, which sigma covers")
    assert placed.sigma_from == "snapshots"
    widened = found.rig.covariances[other] + np.outer(knock.offsets[other], knock.offsets[other])
    np.testing.assert_allclose(placed.covariance, widened, atol=1e-9)


@pytest.mark.parametrize("seed", range(100, 104))
def test_chance_is_no_possible_knock(seed):
    assert refined(pairs(_EVERY, np.random.default_rng(seed))).possible_knock is None


@pytest.mark.parametrize(("by_m", "is_knock"), [(0.4, True), (0.6, False)])
def test_a_lidar_that_moved_too_far_was_not_knocked(by_m, is_knock):
    every = list(_knocked(pairs(_EVERY, np.random.default_rng(10)), "B", {"stop 4"}, by_m))
    found = find_knock("A", solve_views("A", every), [f"stop {number}" for number in range(1, 5)])
    assert (found is not None) == is_knock


@pytest.mark.parametrize("seed", range(20, 24))
def test_no_knock_is_invented(seed):
    assert not refined(pairs(_EVERY, np.random.default_rng(seed))).knocks


@pytest.mark.slow
@pytest.mark.parametrize("seed", some_of(range(30, 33), 1))
def test_covariances_that_are_too_small_invent_no_knock(seed):
    assert not refined(pairs(_EVERY, np.random.default_rng(seed), noise=2.5)).knocks
