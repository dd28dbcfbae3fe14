# SPDX-License-Identifier: Apache-2.0
"""Poses of LiDARs and stops out of made registrations of views."""

from dataclasses import replace

import numpy as np
import pytest

from multilica.acceptance.view_graph import ViewGraph
from multilica.config import CalibrationConfig, RefineConfig
from multilica.multi_snapshot import SnapshotRun, join
from multilica.multi_snapshot.trusted_links import refine_linked
from multilica.registration.poses import moved
from multilica.registration.view_poses import ViewPoses
from multilica.results import CalibrationResult, DriveView, LidarPlacement, LinkedStops, Reason, Verdict
from multilica.stages.refine import _Share, refine
from tests.multi_snapshot.made_drive import LIDARS, SIGMA, STOPS, STRAIGHT, pair, pairs, refined, split
from tests.unit.derivatives import assert_alike, derivative

_CONFIG = RefineConfig()
# B is seen by A only across stops, C by A within the first.
_CROSSED = "A1-A2 A2-A3 A1-A3 A1-B3 A3-B1 A2-B2 B1-B2 A1-C1 C1-C2"


def _errors(found, root="A"):
    return {
        name: pose.offset_from(LIDARS[root].inverse() @ LIDARS[name])
        for name, pose in found.rig.poses.items()
        if name != root
    }


@pytest.mark.parametrize("text", ["A1-B3 A3-B1 A1-A3 A1-A2 A3-A2 A2-B1", "A1-B1 A1-A2 B1-B2 A2-A3 A1-A3", _CROSSED])
@pytest.mark.parametrize("root", ["A", "B"])
def test_exact_pairs_give_exact_lidars_and_stops(text, root):
    found = refined(pairs(text), root)
    assert "B" in found.rig.poses
    assert max(np.abs(error).max() for error in _errors(found, root).values()) < 1e-7
    first = min(found.rig.stops)
    own = LIDARS[root]
    for name, pose in found.rig.stops.items():
        truth = own.inverse() @ STOPS[first].inverse() @ STOPS[name] @ own
        assert np.abs(pose.matrix - truth.matrix).max() < 1e-7
    assert not found.refused


@pytest.mark.slow
@pytest.mark.in_turn
def test_the_covariance_is_that_of_many_noisy_drives():
    rng = np.random.default_rng(0)
    normalised = []
    for _ in range(30):
        found = refined(pairs(_CROSSED, rng))
        for name, error in _errors(found).items():
            normalised.append(error @ np.linalg.solve(found.rig.covariances[name], error))
        for name, covariance in found.rig.stop_covariances.items():
            error = found.rig.stops[name].offset_from(STOPS["stop 1"].inverse() @ STOPS[name])
            normalised.append(error @ np.linalg.solve(covariance, error))
    # The refusal of one link in a thousand and the robust weights change little.
    assert np.mean(normalised) == pytest.approx(6.0, rel=0.15)


def test_the_first_stop_may_be_any():
    """The pose of a LiDAR and its covariance do not depend on which stop is the origin."""
    rng = np.random.default_rng(1)
    every = pairs("A1-A2 A2-A3 A1-A3 A1-B3 A3-B1", rng)
    graph = ViewGraph.of(sorted({view for each in every for view in each.views}), every)
    poses, linked = graph.lidar_poses("A"), graph.linked_stops("A", every)
    rigs = []
    for origin in linked.poses:
        to_origin = linked.poses[origin].inverse()
        stops = {name: to_origin @ pose for name, pose in linked.poses.items()}
        rigs.append(refine("A", poses, [], _CONFIG, LinkedStops(every, stops, frozenset([origin]))))
    for rig in rigs[1:]:
        assert np.abs(rig.poses["B"].matrix - rigs[0].poses["B"].matrix).max() < 1e-7
        np.testing.assert_allclose(rig.covariances["B"], rigs[0].covariances["B"], rtol=1e-4, atol=1e-12)


def test_stops_without_links_are_joined_as_before():
    rng = np.random.default_rng(2)
    within = pairs("A1-B1 A2-B2 B2-C2 A3-C3", rng)
    found = refined(within)
    plain = refine("A", found.rig.poses, [each.registration for each in within], _CONFIG)
    for name in "BC":
        assert np.abs(found.rig.poses[name].matrix - plain.poses[name].matrix).max() < 1e-7
        np.testing.assert_allclose(found.rig.covariances[name], plain.covariances[name], rtol=1e-5, atol=1e-15)
    assert not found.rig.stops


def test_links_hardly_move_a_lidar_that_they_do_not_hold():
    """A stop with a single link to the rest takes its place, and tells of the LiDARs only that it is one place."""
    rng = np.random.default_rng(3)
    within = pairs("A1-B1 A2-B2", rng)
    alone = refine("A", {name: LIDARS[name] for name in "AB"}, [each.registration for each in within], _CONFIG)
    link = pairs("A1-A2", rng)
    linked = LinkedStops(link, {name: STOPS[name] for name in ("stop 1", "stop 2")}, frozenset(["stop 1"]))
    rig = refine("A", alone.poses, [each.registration for each in within], _CONFIG, linked)
    assert np.abs(rig.poses["B"].matrix - alone.poses["B"].matrix).max() < 1e-7
    np.testing.assert_allclose(rig.repeatability["B"], alone.repeatability["B"], rtol=1e-6)
    place = np.diag([0.0, 0.0, 0.0, 7e-4, 7e-4, 7e-4]) ** 2
    np.testing.assert_allclose(
        rig.covariances["B"] - place, alone.covariances["B"] - place / 2.0, rtol=1e-6, atol=1e-12
    )


def test_derivatives_of_a_view_by_its_lidar_and_its_stop():
    """The chain rule against differences, for the gradient at a pose that the link does not agree with."""
    rng = np.random.default_rng(4)
    link = pair("B2", "C3", rng, noise=3.0)
    poses = dict(LIDARS)

    def offset(step):
        lidars = {
            name: moved(poses[name], step[6 * at : 6 * at + 3], step[6 * at + 3 : 6 * at + 6])
            for at, name in enumerate("BC")
        }
        stops = {
            name: moved(STOPS[name], step[6 * at : 6 * at + 3], step[6 * at + 3 : 6 * at + 6])
            for at, name in ((2, "stop 2"), (3, "stop 3"))
        }
        target, source = stops["stop 2"] @ lidars["B"], stops["stop 3"] @ lidars["C"]
        return (target.inverse() @ source).offset_from(link.registration.T_target_source)

    views = ViewPoses(poses, dict(STOPS), ["B", "C"], ["stop 2", "stop 3"])
    jacobian, columns = views.jacobian(link)
    found = np.zeros((6, 24))
    found[:, columns] = jacobian
    assert_alike(found, derivative(offset, 24), 1e-2)


_ALONE = "A1-A2 A2-A3 A1-A3 A3-A4 A2-A4 B1-B2 B2-B3 B1-B3 B3-B4 B2-B4"


def test_what_no_pair_determines_has_no_pose():
    """The motion of each LiDAR alone, straight on: nothing tells where B is."""
    found = refined(pairs(_ALONE, np.random.default_rng(6), stops=STRAIGHT))
    assert set(found.rig.poses) == {"A"}
    assert set(found.rig.stops) == {*STRAIGHT}
    assert {link.target for link in found.links if not link.used} == {"B"}


@pytest.mark.in_turn
@pytest.mark.slow
def test_motions_that_turn_determine_unconnected_lidars():
    """The motion of each LiDAR alone, as in hand-eye calibration."""
    found = refined(pairs(_ALONE, np.random.default_rng(6)))
    error = _errors(found)["B"]
    assert error @ np.linalg.solve(found.rig.covariances["B"], error) < 20.0
    assert not found.refused


@pytest.mark.slow
def test_a_crossed_drive_determines_unconnected_lidars():
    """Each LiDAR saw what the other saw, never both at one stop."""
    found = refined(pairs("A1-A2 A1-B3 B3-B4 A1-B4 A2-B3 B1-B2 A4-B1 A3-A4 A4-B2", np.random.default_rng(7)))
    error = _errors(found)["B"]
    assert error @ np.linalg.solve(found.rig.covariances["B"], error) < 20.0


def test_a_single_link_is_not_trusted():
    found = refined(pairs("A1-B1 A2-B2 A1-A2"))
    assert not found.rig.stops
    (link,) = found.links
    assert not link.used
    assert "confirms" in link.reason


_GOOD = "A1-A2 A2-A3 A1-B2 A2-B1 A2-B3 A3-B2 B1-B2 B2-B3"


def test_a_link_that_differs_from_the_others_is_refused():
    rng = np.random.default_rng(5)
    found = refined([*pairs(_GOOD, rng), pair("B1", "A3", rng, off=[0, 0, 0, 0.03, 0, 0])])
    refused = [link for link in found.links if not link.used]
    assert [(link.target, link.target_stop, link.source, link.source_stop) for link in refused] == [
        ("B", "stop 1", "A", "stop 3")
    ]
    assert np.all(np.abs(_errors(found)["B"]) < 5.0 * SIGMA)


def test_a_place_known_to_look_alike_has_no_links():
    within, links = split(pairs(_GOOD + " A1-B1", np.random.default_rng(5)))
    found = refine_linked("A", within, links, _CONFIG, looks_alike=True)
    assert not found.rig.stops
    assert set(found.rig.poses) == {"A", "B"}


def _against(stop):
    """Beams of A and B contradict each other at that stop, wherever they are."""
    return lambda pose, own: stop if {pose.target, pose.source} == {"A", "B"} and stop not in own else ""


def test_beams_of_another_stop_refuse_what_links_tell():
    within, links = split(pairs("A1-A2 A2-A3 A1-A3 A1-B3 A3-B1 A2-B3", np.random.default_rng(8)))
    assert set(refine_linked("A", within, links, _CONFIG).rig.poses) == {"A", "B"}
    found = refine_linked("A", within, links, _CONFIG, _against("stop 2"))
    assert set(found.rig.poses) == {"A"}
    refused = {(link.target, link.source): link.reason for link in found.links if not link.used}
    assert {*refused} == {("A", "A"), ("A", "B")}
    assert "stop 2" in refused["A", "B"]


def test_beams_of_another_stop_refuse_what_one_stop_tells():
    """Links that have nothing to do with it stay."""
    within, links = split(pairs("A1-A2 A2-A3 A1-A3 A2-B2 A2-C2", np.random.default_rng(9)))
    found = refine_linked("A", within, links, _CONFIG, _against("stop 3"))
    assert set(found.rig.poses) == {"A", "C"}
    assert {conflict.stop for conflict in found.conflicts} == {"stop 3"}
    kept = refine_linked("A", within, links, _CONFIG, _against("stop 2"))
    assert set(kept.rig.poses) == {"A", "B", "C"}


def test_links_that_put_a_lidar_off_the_vehicle_do_not_count():
    """Posts of a rail repeat, and links that agree with each other put a LiDAR 23 m off. Here it is 1.3 m from A."""
    within, links = split(pairs("A1-A2 A2-A3 A1-A3 A1-B3 A3-B1 A2-B3", np.random.default_rng(8)))
    assert set(refine_linked("A", within, links, _CONFIG, max_baseline_m=1.5).rig.poses) == {"A", "B"}
    found = refine_linked("A", within, links, _CONFIG, max_baseline_m=1.2)
    assert set(found.rig.poses) == {"A"}
    assert all("farther from A than" in link.reason for link in found.links)


def test_undecided_links_do_not_count():
    within, links = split(pairs("A1-A2 A2-A3 A1-A3 A1-B3 A3-B1 A2-B3", np.random.default_rng(8)))
    verdict = Verdict("undecided", (Reason("held_by_repetition", -1.0, 0.0, "made"),))
    links = [
        replace(link, registration=replace(link.registration, verdict=verdict))
        if "B" in link.registration.lidars
        else link
        for link in links
    ]
    found = refine_linked("A", within, links, _CONFIG)
    assert set(found.rig.poses) == {"A"}
    assert [link.reason for link in found.links if "B" in (link.target, link.source)] == ["made"] * 3
    assert sum(link.used for link in found.links) == 3


@pytest.mark.parametrize(("max_baseline_m", "is_placed"), [(1.5, True), (1.2, False)])
def test_the_joint_rig_keeps_the_largest_baseline(max_baseline_m, is_placed):
    links = pairs("A1-A2 A2-A3 A1-A3 A1-B3 A3-B1 A2-B3", np.random.default_rng(8))
    alone = CalibrationResult("A", "", tuple(LidarPlacement(name, "nothing in common") for name in "AB"))
    config = CalibrationConfig(target="A", acceptance={"max_baseline_m": max_baseline_m})
    found = join([SnapshotRun(stop, alone) for stop in STOPS], config, links=links)["B"]
    assert (found.T_target_source is not None) == is_placed
    assert ("acceptance.max_baseline_m" in found.reason) is not is_placed


def test_a_lidar_that_one_stop_puts_elsewhere_has_no_links_there():
    within, links = split(pairs("A1-B1 A3-B3 A1-A2 A2-A3 A1-A3 B1-B2 B2-B3", np.random.default_rng(12)))
    moved = [DriveView("B", "stop 2")]
    found = refine_linked("A", within, links, _CONFIG, _against("stop 2"), moved)
    assert set(found.rig.poses) == {"A", "B"}
    assert not found.conflicts
    assert {link.target for link in found.links if not link.used} == {"B"}


def test_both_sides_of_a_lidar_with_itself_share_its_biases():
    """The sums of a link by its pose and three biases, the last of which is an earlier one again."""
    rng = np.random.default_rng(13)
    rows = rng.normal(size=(20, 9))
    (link,) = pairs("A1-A2", rng)
    total = np.zeros((10, 10))
    _Share(link.registration, 1.0, np.eye(6), np.array([0, 1, 2, 3, 4, 5, 8, 9, 8]), 1).add(rows.T @ rows, total, 0.5)
    shared = np.column_stack([rows[:, :6], np.zeros((20, 2)), rows[:, 6] + rows[:, 8], rows[:, 7]])
    np.testing.assert_allclose(total, 0.5 * shared.T @ shared, atol=1e-12)
