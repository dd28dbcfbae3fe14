# SPDX-License-Identifier: Apache-2.0
"""All poses on a plane that fit the headings of pairs."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from multilica.geometry import RigidTransform, rotation_angle_rad
from multilica.multi_snapshot import planar_poses as module
from multilica.multi_snapshot import view_solution
from multilica.multi_snapshot.common_ground import ground_pairs
from multilica.multi_snapshot.planar_poses import planar_poses
from multilica.multi_snapshot.view_solution import solutions_on_plane, solve_views
from multilica.registration.poses import moved
from tests.multi_snapshot.made_drive import LIDARS, STOPS, pairs

# The vehicle leans, and the LiDARs are tilted: A lies on its side.
_UPRIGHT = {
    name: RigidTransform.from_xyz_rpy("up", name, [-1.2 * n, 0.4 * n, 0.1 * n], [0.3 * n, -0.2 * n, 2.1 * n])
    for n, name in enumerate("ABC")
}
_TURNS = {"stop 1": (0.0, 0.0, 0.0), "stop 2": (5.0, 2.0, 1.1), "stop 3": (-2.0, 6.0, 2.4), "stop 4": (3.0, 9.0, 3.4)}
# Each LiDAR sees what another one saw; the headings of three stops have two solutions.
_THREE_STOPS = "A1-B2 A2-C3 B3-C1 B1-A3 C2-B1"
_FOUR_STOPS = "A1-B3 A3-C4 C1-A2 B2-C4 A4-B1 C3-B4"


@pytest.fixture
def drive(monkeypatch):
    """Make pairs on a plane, of LiDARs that see the ground; their true poses are relative to A."""
    T_up_A = _UPRIGHT["A"]
    lidars = {name: T_up_A.inverse() @ pose for name, pose in _UPRIGHT.items()}
    stops = {}
    for name, (x_m, y_m, yaw_rad) in _TURNS.items():
        at = RigidTransform.from_xyz_rpy("up", "up", [x_m, y_m, 0.0], [0.0, 0.0, yaw_rad])
        stops[name] = RigidTransform("A", "A", (T_up_A.inverse() @ at @ T_up_A).matrix)
    for name, pose in lidars.items():
        monkeypatch.setitem(LIDARS, name, pose)
    levels = {name: RigidTransform("ground", name, pose.matrix) for name, pose in _UPRIGHT.items()}
    return lambda text: (pairs(text, np.random.default_rng(3), stops=stops), ground_pairs(levels))


def _off_m(solution, root="A"):
    found = solution.poses if isinstance(solution.poses, dict) else solution.poses.poses
    return max(pose.distance_to(LIDARS[root].inverse() @ LIDARS[name])[0] for name, pose in found.items())


@pytest.mark.parametrize("text", [_THREE_STOPS, _FOUR_STOPS])
@pytest.mark.parametrize("root", ["A", "C"])
def test_one_of_all_solutions_is_the_true_one(drive, text, root):
    made, grounds = drive(text)
    found = planar_poses(root, made, grounds)
    assert len([each for each in found if _off_m(each, root) < 0.1]) == 1
    assert all(each.poses.keys() == {*"ABC"} for each in found)


def test_headings_told_twice_over_have_several_solutions(drive):
    made, grounds = drive(_THREE_STOPS)
    found = sorted(planar_poses("A", made, grounds), key=_off_m)
    assert len(found) > 1
    for one, other in combinations(found, 2):
        turns = [rotation_angle_rad(one.poses[name].rotation.T @ other.poses[name].rotation) for name in "ABC"]
        turns += [rotation_angle_rad(one.stops[name].rotation.T @ other.stops[name].rotation) for name in one.stops]
        assert max(turns) > 0.5
    for solution in found:
        for each in made:
            target, source = (
                solution.stops[view.stop] @ solution.poses[view.lidar] for view in (each.target, each.source)
            )
            turn = (target.inverse() @ source).rotation.T @ each.registration.T_target_source.rotation
            assert rotation_angle_rad(turn) < np.deg2rad(2.0)


def test_positions_that_no_vehicle_has_are_no_solution(drive):
    made, grounds = drive(_THREE_STOPS)
    every = solutions_on_plane("A", made, grounds, 1e6)
    assert [each.squared for each in every] == sorted(each.squared for each in every)
    farthest_m = max(float(np.linalg.norm(pose.xyz_m)) for each in every for pose in each.poses.poses.values())
    assert len(solutions_on_plane("A", made, grounds, 0.7 * farthest_m)) < len(every)


def test_positions_that_hardly_anything_tells_may_be_nearer(drive):
    """A turn about one axis tells no position along it: LiDARs that came to lie far up there count as near."""
    told = solve_views("A", *drive(_FOUR_STOPS))
    open_upwards = solve_views("A", drive("A1-A2 A2-A3 A1-A3 B1-B2 B2-B3 B1-B3")[0])
    assert open_upwards.poses.poses.keys() == {*"AB"}
    up = _UPRIGHT["A"].rotation.T[:, 2]
    for solution, counts in ((told, True), (open_upwards, False)):
        poses = {name: moved(pose, np.zeros(3), 20.0 * up) for name, pose in solution.poses.poses.items()}
        far = replace(solution, poses=replace(solution.poses, poses=poses))
        assert (far.beyond(15.0) > 100.0) is counts
        assert far.beyond(25.0) == 0.0


def test_a_pose_that_all_solutions_share_is_told(drive):
    made, grounds = drive(_FOUR_STOPS)
    assert _off_m(solve_views("A", made, grounds)) < 0.03


def test_a_pose_in_which_solutions_differ_is_not_told(drive, monkeypatch):
    made, grounds = drive(_FOUR_STOPS)
    true = solve_views("A", made, grounds)
    elsewhere = {**true.poses.poses, "C": moved(true.poses.poses["C"], np.zeros(3), np.ones(3))}
    other = replace(true, poses=replace(true.poses, poses=elsewhere), squared=true.squared + 90.0)
    told = []
    monkeypatch.setattr(view_solution, "_pseudo", lambda pose, _: told.append(pose.source))
    for solutions in ([true, other], [true], [true, replace(other, squared=true.squared + 110.0)]):
        monkeypatch.setattr(view_solution, "solutions_on_plane", lambda *_, found=solutions: found)
        monkeypatch.setattr(view_solution, "_fits", lambda *_: [])
        told.append(len(solutions))
        known = replace(true, poses=replace(true.poses, poses={name: true.poses.poses[name] for name in "AB"}))
        view_solution._next_lidar("A", sorted({view for each in made for view in each.views}), made, [], grounds, known)
    assert told == [2, 1, "C", 2, "C"]


@pytest.mark.parametrize(
    "text",
    ["A1-B2", "A1-A2 B1-B2", "A1-B2 B2-A3 C3-C4", "A1-A2 C1-C2 C2-C3", ""],
    ids=["one link", "each alone", "stops apart", "none but its own", "no links"],
)
def test_headings_that_nothing_tells_have_no_solution(drive, text):
    made, grounds = drive(text)
    assert planar_poses("A", made, grounds) == []


def test_without_ground_in_sight_there_is_no_plane(drive):
    made, grounds = drive(_FOUR_STOPS)
    assert planar_poses("A", made, []) == []
    assert planar_poses("A", made, [each for each in grounds if each.registration.source != "C"]) == []
    assert planar_poses("D", made, grounds) == []


def test_pairs_whose_headings_differ_have_no_solution(drive):
    made, grounds = drive("A1-A2 A2-A3 A1-A3 A1-B3 A3-B2")
    assert planar_poses("A", made, grounds)
    pose = made[0].registration.T_target_source
    up = _UPRIGHT["A"].rotation.T[:, 2]
    made[0] = replace(made[0], registration=replace(made[0].registration, T_target_source=moved(pose, 0.3 * up, up)))
    assert planar_poses("A", made, grounds) == []


def test_too_many_solutions_are_none(drive, monkeypatch):
    made, grounds = drive(_THREE_STOPS)
    monkeypatch.setattr(module, "_MOST_SOLUTIONS", 1)
    assert planar_poses("A", made, grounds) == []


def test_the_stops_of_a_drive_on_uneven_ground_fit_roughly():
    over_ground = RigidTransform.from_xyz_rpy("ground", "A", [0.0, 0.0, 1.8], [0.01, -0.02, 0.0])
    levels = {name: over_ground @ pose for name, pose in LIDARS.items()}
    made = pairs(_FOUR_STOPS, np.random.default_rng(4), stops=STOPS)
    assert min(map(_off_m, planar_poses("A", made, ground_pairs(levels)))) < 1.0
