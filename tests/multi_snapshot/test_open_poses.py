# SPDX-License-Identifier: Apache-2.0
"""Poses of LiDARs that links leave open in some direction, or that no chain of links tells."""

from dataclasses import replace

import numpy as np
import pytest

from multilica import drive_calibration
from multilica.config import CalibrationConfig, RefineConfig
from multilica.geometry import RigidTransform
from multilica.multi_snapshot import trusted_links
from multilica.multi_snapshot.common_ground import ground_pairs, ground_pairs_of, vertical_of
from multilica.multi_snapshot.trusted_links import refine_linked
from multilica.multi_snapshot.view_solution import solve_views
from multilica.orchestration.links import FoundLinks
from multilica.results import CalibrationResult, DriveView, LidarPlacement
from multilica.workers import Workers
from tests.multi_snapshot.made_drive import LIDARS, STOPS, STRAIGHT, pair, pairs, view_pose

_OVER_GROUND = RigidTransform.from_xyz_rpy("ground", "A", [0.0, 0.0, 1.8], [0.01, -0.02, 0.0])
_LEVELS = {name: _OVER_GROUND @ pose for name, pose in LIDARS.items()}
# A, B and C look in different directions: each link is between two of them, and only all together tell the poses.
_CROSSED = "B1-C3 A2-C3 A3-B2 A3-C4 B1-A2 B2-C4"


def _refined(text, against=None, levels=None):
    return refine_linked("A", dict.fromkeys(STOPS, ()), _links(text), RefineConfig(), against, levels=levels or {})


def _links(text):
    return pairs(text, np.random.default_rng(1))


@pytest.mark.parametrize("root", ["A", "B", "C"])
def test_links_that_form_no_chain_tell_the_poses_together(root):
    """From no heading do they lead there at once: at first they have to count less."""
    links = _links("A1-B3 A3-C4 C1-A2 B2-C4 A4-B1 C3-B4")
    solution = solve_views(root, links, ground_pairs(_LEVELS))
    assert solution.poses.poses.keys() == {*"ABC"}
    for name, pose in solution.poses.poses.items():
        assert pose.distance_to(LIDARS[root].inverse() @ LIDARS[name])[0] < 0.02


@pytest.mark.parametrize(("sigma_m", "is_confirmed"), [(0.2, True), (0.6, True), (0.8, False)])
def test_one_axis_may_be_told_roughly(sigma_m, is_confirmed):
    """The second link tells all of the first one but its x, which it tells to that sigma."""
    link, other = pair("A1", "A2"), pair("A1", "A2")
    information = np.diag([1e8, 1e8, 1e8, sigma_m**-2.0, 1e6, 1e6])
    rough = replace(other, registration=replace(other.registration, information=information))
    assert solve_views("A", [link, rough]).is_confirmed(link) == is_confirmed


@pytest.mark.parametrize(("axis", "is_confirmed"), [(2, True), (3, False)], ids=["a turn", "a way"])
def test_a_turn_may_stay_open(axis, is_confirmed):
    link, other = pair("A1", "A2"), pair("A1", "A2")
    sigmas = np.full(6, 0.01)
    sigmas[axis] = 2.0
    rough = replace(other, registration=replace(other.registration, information=np.diag(sigmas**-2.0)))
    assert solve_views("A", [link, rough]).is_confirmed(link) == is_confirmed


@pytest.mark.parametrize(
    ("sigmas", "is_confirmed"),
    [([0.01, 0.01, 0.01, 9.0, 9.0, 9.0], True), ([0.01, 0.01, 0.2, 1.0, 0.01, 0.01], False)],
    ids=["the attitude is told", "it is not"],
)
def test_of_a_unique_link_only_the_attitude_has_to_be_told(sigmas, is_confirmed):
    link, other = pair("A1", "A2"), pair("A1", "A2")
    rough = replace(other, registration=replace(other.registration, information=np.diag(np.array(sigmas) ** -2.0)))
    unique = replace(link, is_unique=True)
    assert not solve_views("A", [link, rough]).is_confirmed(link)
    assert solve_views("A", [unique, rough]).is_confirmed(unique) == is_confirmed


@pytest.mark.parametrize(("others", "factor"), [("", 2.0), (" A2-B3", 1.0)], ids=["alone", "with another"])
def test_a_link_that_alone_tells_a_position_is_less_certain(monkeypatch, others, factor):
    turned = np.diag(np.repeat([1e4, 1e-6], 3))
    text = f"A1-B3 A1-A2 A2-A3 A1-A3 B1-B2 B2-B3 B1-B3{others}"
    links = pairs(text, np.random.default_rng(1), stops=STRAIGHT)
    attitude = pair("A1", "B1")
    attitude = replace(attitude, registration=replace(attitude.registration, information=turned))
    links[0] = replace(links[0], is_unique=True)
    sigmas_m = []
    for each in (2.0, 1.0):
        monkeypatch.setattr(trusted_links, "_ALONE_IN_PLACE", each)
        within = dict.fromkeys(STOPS, ()) | {"stop 1": (attitude.registration,)}
        rig = refine_linked("A", within, links, RefineConfig()).rig
        sigmas_m.append(np.sqrt(np.linalg.eigvalsh(rig.covariances["B"][3:, 3:])[-1]))
    assert sigmas_m[0] / sigmas_m[1] == pytest.approx(factor, rel=0.3)


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
    for each in ground_pairs(levels):
        offset = (LIDARS[target].inverse() @ LIDARS[each.source.lidar]).offset_from(each.registration.T_target_source)
        information = np.asarray(each.registration.information)
        assert offset @ information @ offset < 1e-9
        assert np.linalg.matrix_rank(information) == 3
    assert [each.source.lidar for each in ground_pairs(levels)] == [*seen[1:]]


@pytest.mark.parametrize("posed", ["ABC", "BC", "AC", "B", ""])
def test_the_ground_of_some_lidars_counts_without_the_others(posed):
    found = ground_pairs_of([*posed], ground_pairs(_LEVELS))
    for each in found:
        pair = each.registration
        offset = (LIDARS[pair.target].inverse() @ LIDARS[pair.source]).offset_from(pair.T_target_source)
        along_m = _LEVELS[pair.target].rotation[2]
        assert offset @ np.asarray(pair.information) @ offset < 1e-9
        np.testing.assert_allclose(np.abs(vertical_of(each) @ along_m), 1.0)
    assert [(each.target.lidar, each.source.lidar) for each in found] == [(posed[0], name) for name in posed[1:]]


@pytest.mark.parametrize("heading_deg", [0.0, 90.0, 135.0, 170.0, 180.0])
def test_the_ground_levels_lidars_that_face_apart(heading_deg):
    """The ground tells no heading, however far the LiDARs are turned from each other."""
    of_b = RigidTransform.from_xyz_rpy("A", "B", [-2.0, 0.5, 0.0], [0.0, 0.0, np.deg2rad(heading_deg)])
    unturned = RigidTransform.from_xyz_rpy("ground", "ground", [0.0, 0.0, 0.0], [0.0, 0.0, -np.deg2rad(heading_deg)])
    levels = {"A": _OVER_GROUND, "B": unturned @ _OVER_GROUND @ of_b}
    tilted = of_b @ RigidTransform.from_xyz_rpy("B", "B", [0.0, 0.0, 0.0], [0.08, -0.05, 0.0])
    known = pair("A1", "B1")
    information = np.diag([1e-2, 1e-2, 1e6, 1e6, 1e6, 1e6])
    known = replace(known, registration=replace(known.registration, T_target_source=tilted, information=information))
    solution = solve_views("A", [known], ground_pairs(levels))
    vertical = solution.poses.poses["B"].rotation.T @ _OVER_GROUND.rotation[2]
    np.testing.assert_allclose(vertical, levels["B"].rotation[2], atol=1e-4)
    assert solution.squared < 1e-3


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


def test_views_have_the_poses_that_all_links_tell():
    links = _links("A1-B3 A3-C4 C1-A2 B2-C4 A4-B1 C3-B4")
    poses = solve_views("A", links, ground_pairs(_LEVELS)).view_poses
    assert {view.lidar for view in poses} == {*"ABC"}
    (first,) = {pose.target for pose in poses.values()}
    T_first_root = view_pose(DriveView("A", first)).inverse()
    for view, pose in poses.items():
        assert pose.source == view.label
        off = RigidTransform("A", view.lidar, pose.matrix).distance_to(T_first_root @ view_pose(view))
        assert off == pytest.approx((0.0, 0.0), abs=0.05)


def test_views_of_stops_apart_have_none():
    assert solve_views("A", _links("A1-A2 A3-A4")).view_poses == {}
    assert solve_views("A", []).view_poses == {}


def test_all_links_lead_to_further_ones_where_none_confirms_them(monkeypatch):
    """Each link is right, and without one of them the others do not tell the poses."""
    asked = []

    def follow(stops, _config, _workers, found, poses, lidars, _deadline_s):
        asked.append((len(stops), {view.lidar for view in poses}, lidars))
        return replace(found, links=(*found.links, *_links("A1-B3")))

    joined = []
    placements = (LidarPlacement("A", "made", T_target_source=LIDARS["A"]), LidarPlacement("B", "made"))
    result = CalibrationResult("A", "made", placements)
    monkeypatch.setattr(drive_calibration, "search_links", lambda *_: FoundLinks(tuple(_links(_CROSSED))))
    monkeypatch.setattr(drive_calibration, "mark_unique", lambda *arguments: arguments[3])
    monkeypatch.setattr(drive_calibration, "follow_poses", follow)
    monkeypatch.setattr(drive_calibration, "follow_motions", lambda *arguments: arguments[3])
    monkeypatch.setattr(drive_calibration, "join", lambda *arguments, **_: (joined.append(arguments[2]), result)[1])
    drive_calibration._link((), (), CalibrationConfig(), Workers(), list, np.inf)
    assert asked == [(0, {*"ABC"}, {"B"})]
    assert len(joined[-1]) == 7


@pytest.mark.parametrize(
    ("evidence", "adopted"),
    [((9.0, 1.0), 0), ((1.0, 9.0), 1), ((9.0, 6.0), None), ((3.0, 0.0), None)],
    ids=["the first", "the second", "both alike", "hardly any"],
)
def test_beams_tell_which_solution_of_the_headings_is_right(monkeypatch, evidence, adopted):
    every = _links("A1-A2")
    found = [solve_views("A", _links(text)) for text in ("A1-B3 A3-B3 A1-A3 C1-A3", "A1-C2 A2-C2 B1-A2")]
    further = [
        replace(link, registration=replace(link.registration, fitness=each))
        for each, link in zip(evidence, _links("A1-B3 A1-C3"), strict=True)
    ]

    def follow(_stops, _config, _workers, known, poses, _lidars, _deadline_s):
        (number,) = (number for number, each in enumerate(found) if each.view_poses.keys() == poses.keys())
        return replace(known, weak=(further[number],))

    monkeypatch.setattr(drive_calibration, "follow_poses", follow)
    monkeypatch.setattr(drive_calibration, "solutions_on_plane", lambda *_: found)
    result = CalibrationResult("A", "made", (LidarPlacement("B", "made"), LidarPlacement("C", "made")))
    before = FoundLinks(tuple(every))
    after = drive_calibration._followed_from_all((), CalibrationConfig(), Workers(), before, result, np.inf)
    assert after.weak == (() if adopted is None else (further[adopted],))


def test_a_solution_that_time_leaves_untested_decides_nothing(monkeypatch):
    """Another solution may have as many links."""
    every, further = _links("A1-A2"), _links("A1-B3")
    found = [solve_views("A", _links(text)) for text in ("A1-B3 A3-B3 A1-A3", "A1-C2 A2-C2 B1-A2")]
    answers = iter([{"weak": tuple(further)}, {"not_reached": (("stop 1", "stop 2"),)}])
    monkeypatch.setattr(drive_calibration, "follow_poses", lambda *arguments: replace(arguments[3], **next(answers)))
    monkeypatch.setattr(drive_calibration, "solutions_on_plane", lambda *_: found)
    result = CalibrationResult("A", "made", (LidarPlacement("B", "made"), LidarPlacement("C", "made")))
    before = FoundLinks(tuple(every))
    after = drive_calibration._followed_from_all((), CalibrationConfig(), Workers(), before, result, np.inf)
    assert after == replace(before, not_reached=(("stop 1", "stop 2"),))


def test_a_chain_over_several_stops_links_them_all():
    """A and C share stop 3, C and B stop 4: so stops 1 and 2, where A and B share no pair, have one motion."""
    within = [pair("A3", "C3"), pair("B4", "C4")]
    links = [pair("B1", "B2"), pair("A1", "A3"), pair("A2", "C4")]
    solution = solve_views("B", [*within, *links])
    assert solution.poses.poses.keys() == {*"ABC"}
    assert len(solution.first) == 1
    for view, pose in solution.view_poses.items():
        (first,) = solution.first
        T_first_root = view_pose(DriveView("B", first)).inverse()
        off = RigidTransform("B", view.lidar, pose.matrix).distance_to(T_first_root @ view_pose(view))
        assert off == pytest.approx((0.0, 0.0), abs=1e-3)
    assert not any(solution.is_confirmed(link) for link in links), "there are no more pairs than unknown poses"


@pytest.mark.parametrize("links", ["", "A1-A2"], ids=["none", "one that nothing confirms"])
def test_without_links_the_ground_places_no_lidar(monkeypatch, links):
    """B and C share pairs at two stops, A and D at one of them."""
    monkeypatch.setitem(LIDARS, "D", RigidTransform.from_xyz_rpy("A", "D", [1.0, 1.0, 0.0], [0.0, 0.0, 0.5]))
    within = dict.fromkeys(STOPS, ())
    within["stop 1"] = (pair("A1", "D1").registration, pair("B1", "C1").registration)
    within["stop 2"] = (pair("B2", "C2").registration,)
    levels = {name: _OVER_GROUND @ pose for name, pose in LIDARS.items()}
    rig = refine_linked("A", within, _links(links), RefineConfig(), levels=levels).rig
    assert (rig.poses.keys(), rig.covariances.keys()) == ({*"AD"}, {"D"})
