# SPDX-License-Identifier: Apache-2.0
"""Motions of LiDARs between the stops of a drive."""

import itertools
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from multilica import drive_calibration
from multilica.config import CalibrationConfig, RefineConfig
from multilica.geometry import RigidTransform
from multilica.multi_snapshot import SnapshotRun
from multilica.multi_snapshot.trusted_links import refine_linked
from multilica.orchestration.links import FoundLinks
from multilica.registration.motions import motion_pairs
from multilica.registration.poses import moved
from multilica.results import CalibrationResult, LidarPlacement
from multilica.snapshot import LidarMotion
from multilica.workers import Workers
from tests.multi_snapshot.made_drive import LIDARS, STOPS, STRAIGHT, pair, pairs

_SIGMA = np.array([3e-3] * 3 + [0.03] * 3)
_SHIFT = [0.0, 0.0, 0.0, 4.0, 0.0, 0.0]


def _motions(lidars, rng=None, stops=STOPS, off=None):
    """Motions between consecutive stops, with noise if there are random numbers, those of the last LiDAR off."""
    names = [*stops]
    found = [(names[0], [])]
    for before, after in itertools.pairwise(names):
        own = []
        for lidar in lidars:
            pose = (stops[before] @ LIDARS[lidar]).inverse() @ stops[after] @ LIDARS[lidar]
            error = np.zeros(6) if rng is None else _SIGMA * rng.normal(size=6)
            if off is not None and lidar == lidars[-1]:
                error = error + off
            own.append(LidarMotion(lidar, moved(pose, error[:3], error[3:]), np.diag(_SIGMA**2), 6.0, 30))
        found.append((after, own))
    return motion_pairs(found, {*names})


def _refined(every, motions, levels=None):
    within = {stop: tuple(each.registration for each in every if each.stops == {stop}) for stop in STOPS}
    return refine_linked(
        "A", within, [each for each in every if each.is_link], RefineConfig(), motions=motions, levels=levels or {}
    )


@pytest.mark.slow
def test_motions_tell_a_lidar_that_nothing_else_tells():
    normalised = []
    for seed in range(5):
        found = _refined([], _motions("AB", np.random.default_rng(seed)))
        assert "B" not in found.rig.poses
        told = found.by_motions["B"]
        error = told.T_root_lidar.offset_from(LIDARS["B"])
        normalised.append(error @ np.linalg.solve(told.covariance, error))
        open_m, open_directions = np.linalg.eigh(told.covariance[3:, 3:])
        # The vehicle turns about its vertical, which leaves the height free.
        assert open_m[-1] > 1.0 > open_m[-2]
        assert abs(open_directions[2, -1]) > 0.95
    # The covariance is for errors that are alike on all three ways, and so larger than independent ones need.
    assert 0.2 < np.mean(normalised) < 6.0


@pytest.mark.slow
def test_the_ground_tells_the_height():
    over_ground = RigidTransform.from_xyz_rpy("ground", "A", [0.0, 0.0, 1.8], [0.0, 0.0, 0.0])
    levels = {name: over_ground @ LIDARS[name] for name in "AB"}
    for seed in range(3):
        told = _refined([], _motions("AB", np.random.default_rng(seed)), levels).by_motions["B"]
        error = told.T_root_lidar.offset_from(LIDARS["B"])
        assert error @ np.linalg.solve(told.covariance, error) < 16.0
        assert np.sqrt(np.linalg.eigvalsh(told.covariance[3:, 3:])[-1]) < 0.3


def test_the_ground_tells_the_height_that_links_leave_free():
    over_ground = RigidTransform.from_xyz_rpy("ground", "A", [0.0, 0.0, 1.8], [0.0, 0.0, 0.0])
    levels = {name: over_ground @ LIDARS[name] for name in "AB"}
    every = pairs("A1-A2 A2-A3 A1-A3 B1-B2 B2-B3 B1-B3", np.random.default_rng(8))
    found = _refined(every, _motions("AB", np.random.default_rng(9)), levels)
    assert np.sqrt(np.linalg.eigvalsh(found.rig.covariances["B"][3:, 3:])[-1]) > 0.5
    told = found.by_motions["B"]
    assert np.linalg.norm(told.T_root_lidar.offset_from(LIDARS["B"])[3:]) < 0.1
    assert np.sqrt(np.linalg.eigvalsh(told.covariance[3:, 3:])[-1]) < 0.15


def test_a_straight_drive_leaves_the_pose_open():
    told = _refined([], _motions("AB", stops=STRAIGHT)).by_motions.get("B")
    assert told is None or np.sqrt(np.linalg.eigvalsh(told.covariance[3:, 3:])[-1]) > 3.0


@pytest.mark.parametrize("noise", [None, 1])
def test_motions_do_not_change_poses_by_links(noise):
    rng = None if noise is None else np.random.default_rng(noise)
    every = pairs("A1-A2 A2-A3 A1-A3 A1-B3 A3-B1", np.random.default_rng(0))
    plain, followed = _refined(every, ()), _refined(every, _motions("AB", rng))
    assert len(plain.linked.links) == 5
    for name in "AB":
        np.testing.assert_array_equal(followed.rig.poses[name].matrix, plain.rig.poses[name].matrix)
    np.testing.assert_array_equal(followed.rig.covariances["B"], plain.rig.covariances["B"])
    assert not followed.by_motions


def test_a_motion_confirms_a_single_link():
    every = pairs("A1-B1 A1-A2", np.random.default_rng(1))
    assert not _refined(every, ()).linked.links
    assert len(_refined(every, _motions("A", np.random.default_rng(2))).linked.links) == 1


def test_links_that_agree_on_another_place_are_refused():
    """Both are off by the same motion of the vehicle, as between equal bays, so that they confirm each other."""
    within = pairs("A1-B1 A2-B2")
    shift = replace(STOPS["stop 2"], matrix=moved(STOPS["stop 2"], np.zeros(3), np.array(_SHIFT[3:])).matrix)
    wrong = pairs("A1-A2 B1-B2 A1-B2", stops={**STOPS, "stop 2": shift})
    assert len(_refined([*within, *wrong], ()).linked.links) == 3
    found = _refined([*within, *wrong], _motions("A", np.random.default_rng(3)))
    assert not found.linked.links
    assert set(found.refused.values()) == {
        "the motion of the LiDARs between the stops contradicts it, so the place looks like another one"
    }


def test_a_motion_that_contradicts_the_others_is_left_out():
    motions = _motions("ABC", np.random.default_rng(4), off=np.array(_SHIFT))
    found = _refined([*pairs("A1-B1 B2-C2 A3-C3 A1-A2"), pair("B1", "B2")], motions)
    assert {each.lidar for each in found.motions if not each.used} == {"C"}
    assert len(found.linked.links) == 2


def test_one_odd_motion_of_three_leaves_the_others():
    motions = _motions("ABC", np.random.default_rng(4), off=np.array([0.0, 0.0, 0.25, 1.3, 0.0, 0.0]))
    found = _refined([], motions)
    assert {each.lidar for each in found.motions if each.used} == {"A", "B"}
    assert {*found.by_motions} == {"B"}


def test_lidars_that_turn_differently_prove_nothing():
    """Nothing tells which of two is wrong, so none refuses a link."""
    motions = _motions("AB", np.random.default_rng(6), off=np.array([0.0, 0.0, 0.25, 1.3, 0.0, 0.0]))
    found = _refined(pairs("A1-A2 A2-A3 A1-A3 A1-B3 A3-B1", np.random.default_rng(0)), motions)
    assert not any(each.used for each in found.motions)
    assert len(found.linked.links) == 5


def test_motions_over_an_unused_stop_are_chained():
    rng = np.random.default_rng(5)
    stops = [*STOPS]
    exact = view_pose_of(stops[0]).inverse() @ view_pose_of(stops[2])
    errors = []
    for _ in range(400):
        motions = {}
        for before, after in ((0, 1), (1, 2)):
            pose = view_pose_of(stops[before]).inverse() @ view_pose_of(stops[after])
            error = _SIGMA * rng.normal(size=6)
            motion = LidarMotion("B", moved(pose, error[:3], error[3:]), np.diag(_SIGMA**2), 6.0, 30)
            motions[after] = motion
        (chained,) = motion_pairs(
            [(stops[0], []), (stops[1], [motions[1]]), (stops[2], [motions[2]])], {stops[0], stops[2]}
        )
        assert (chained.target_stop, chained.source_stop) == (stops[0], stops[2])
        offset = chained.registration.T_target_source.offset_from(exact)
        errors.append(offset @ chained.registration.information @ offset)
    assert np.mean(errors) == pytest.approx(6.0, rel=0.15)


def view_pose_of(stop):
    return STOPS[stop] @ LIDARS["B"]


@pytest.mark.parametrize(("sigma_m", "is_open"), [(0.1, False), (0.8, True), (None, True)])
def test_motions_are_read_only_if_a_pose_is_open(monkeypatch, sigma_m, is_open):
    given = []

    def joined(*_, motions, levels):
        given.append((motions, levels))
        pose, covariance = (None, None) if sigma_m is None else (LIDARS["B"], sigma_m**2 * np.eye(6))
        placement = SimpleNamespace(T_target_source=pose, covariance=covariance, status="placed")
        return SimpleNamespace(placements=[placement], time_limit=None)

    stops = [name for name, _ in itertools.islice(STOPS.items(), 2)]
    truth = (STOPS[stops[0]] @ LIDARS["A"]).inverse() @ STOPS[stops[1]] @ LIDARS["A"]
    motion = LidarMotion("A", truth, np.diag(_SIGMA**2), 6.0, 30)
    reads = []
    ways = {stops[1]: lambda: (reads.append(stops[1]), (motion,))[1]}
    alone = {name: partial(_alone, name) for name in stops}
    monkeypatch.setattr(drive_calibration, "search_links", lambda *_: FoundLinks(levels=LIDARS))
    monkeypatch.setattr(drive_calibration, "join", joined)
    monkeypatch.setattr(drive_calibration, "follow_motions", lambda *args: replace(args[3], motions=args[4]()))
    drive_calibration.calibrate_jointly(alone, CalibrationConfig(), Workers(), np.inf, ways)
    assert reads == (stops[1:] if is_open else [])
    assert len(given) == 1 + is_open
    if is_open:
        motions, levels = given[-1]
        assert [(each.target_stop, each.source_stop) for each in motions] == [(stops[0], stops[1])]
        assert levels is LIDARS


def test_no_way_is_followed_after_the_time_limit(monkeypatch):
    """The first way takes all the time that is left; the other ways are named instead, and nothing is registered."""
    clock_s = [0.0]

    def follow():
        clock_s[0] = 10.0
        return (LidarMotion("A", STOPS["stop 2"], np.diag(_SIGMA**2), 6.0, 30),)

    monkeypatch.setattr(drive_calibration.time, "monotonic", lambda: clock_s[0])
    result = CalibrationResult("A", "made", (LidarPlacement("B", "made"),))
    monkeypatch.setattr(drive_calibration, "search_links", lambda *_: FoundLinks())
    monkeypatch.setattr(drive_calibration, "join", lambda *_, **__: result)
    given = []
    monkeypatch.setattr(
        drive_calibration,
        "follow_motions",
        lambda *args: (given.append(args[5]), replace(args[3], motions=args[4]()))[1],
    )
    first, *later = STOPS
    ways = {later[0]: follow, later[1]: lambda: pytest.fail("read"), later[2]: lambda: pytest.fail("read")}
    alone = {name: partial(_alone, name) for name in (first, *later)}
    found = drive_calibration.calibrate_jointly(alone, CalibrationConfig(), Workers(), 5.0, ways)
    assert found.result.time_limit.unlinked_stops == ((later[0], later[1]), (later[1], later[2]))
    assert given == [5.0]


def _alone(name, prepared, _):
    prepared["A"] = object()
    return SnapshotRun(name, SimpleNamespace(trusted=(), placements=(), pairs=(), time_limit=None))
