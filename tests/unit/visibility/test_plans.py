# SPDX-License-Identifier: Apache-2.0
"""Poses at which the plans of the walls coincide after a turn, and of what stands above the ground after a shift."""

from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest

from multilica.geometry import RigidTransform
from multilica.results import Hypothesis
from multilica.visibility.plans import alike_hypotheses, main_axes, repeated_hypotheses, shifted_poses, symmetric_poses
from tests.unit.made_pairs import pose

_UP = np.array([0.0, 0.0, 1.0])
_POSE = pose("t", "s", (1.25, 0.75, 0.0), 0.3)
_FAR_M = 30.0


def _walls(*lines_m, height_m=2.0):
    """Sample vertical walls over lines in the target's frame, closer than the cells of a plan."""
    points = []
    for start_m, end_m in np.asarray(lines_m, dtype=float):
        shares = np.linspace(0.0, 1.0, int(20.0 * np.linalg.norm(end_m - start_m)))[:, None]
        points.append(np.column_stack([start_m + shares * (end_m - start_m), np.full(len(shares), height_m)]))
    return np.concatenate(points)


def _rectangle(low_m, high_m):
    (left, near), (right, far) = low_m, high_m
    corners = [(left, near), (right, near), (right, far), (left, far)]
    return list(zip(corners, [*corners[1:], corners[0]], strict=True))


def _found(walls_m, normal=(1.0, 0.0, 0.0), max_baseline_m=_FAR_M, most=6):
    """Let both LiDARs see the same surfaces."""
    normals = np.broadcast_to(normal, walls_m.shape)
    target = SimpleNamespace(probes_m=walls_m, normals=normals)
    source = SimpleNamespace(probes_m=_POSE.inverse().apply(walls_m), normals=_POSE.inverse().rotate(normals))
    sides = [(RigidTransform.identity("t", "t"), target)], [(RigidTransform.identity("s", "s"), source)]
    return symmetric_poses(*sides, _POSE, _UP, max_baseline_m, most)


# The centre is (1.5, 1): half a turn takes x to 3 - x and y to 2 - y.
_HALL = _walls(*_rectangle((-6.5, -4.0), (9.5, 6.0)))
_TURNED = pose("t", "t", (3.0, 2.0, 0.0), np.pi) @ _POSE


def test_a_hall_looks_the_same_from_its_other_end():
    """A plan does not tell poses apart that are off by a cell."""
    best, *_ = _found(_HALL)
    metres, radians = best.distance_to(_TURNED)
    assert radians < 1e-9
    assert metres < 0.75 * np.sqrt(2.0) + 1e-9


def test_a_group_in_a_hall_is_turned_about_an_axis_it_finds():
    ground_m = _HALL[::2] * [1.0, 1.0, 0.0]
    points_m = np.concatenate([_HALL, ground_m])
    normals = np.concatenate([np.broadcast_to([1.0, 0.0, 0.0], _HALL.shape), np.broadcast_to(_UP, ground_m.shape)])
    here = RigidTransform.identity("t", "t")
    parts = [SimpleNamespace(probes_m=points_m[side::2], normals=normals[side::2]) for side in (0, 1)]
    other = SimpleNamespace(probes_m=_POSE.inverse().apply(points_m), normals=_POSE.inverse().rotate(normals))
    source = [(RigidTransform.identity("s", "s"), other)]
    found = alike_hypotheses([(here, part) for part in parts], source, Hypothesis(_POSE, origin="cliques"), _FAR_M)
    turned = [each.T_target_source for each in found if each.derivation == "turned by 180 deg"]
    assert min(each.distance_to(_TURNED)[0] for each in turned) < 0.75 * np.sqrt(2.0) + 1e-9


def test_a_square_hall_looks_the_same_from_four_sides():
    turns = [found.distance_to(_POSE)[1] for found in _found(_walls(*_rectangle((-4.0, -4.5), (7.0, 6.5))))]
    np.testing.assert_allclose(sorted(turns), [np.pi / 2, np.pi / 2, np.pi], atol=1e-9)


def test_poses_beyond_the_baseline_are_none():
    found_m = [float(np.linalg.norm(found.xyz_m)) for found in _found(_HALL)]
    least_m, most_m = min(found_m), max(found_m)
    assert len(_found(_HALL, max_baseline_m=most_m + 0.01)) == len(found_m)
    assert 0 < len(_found(_HALL, max_baseline_m=most_m - 0.01)) < len(found_m)
    assert _found(_HALL, max_baseline_m=least_m - 0.01) == []


@pytest.mark.parametrize(("angle_deg", "is_wall"), [(30.0, True), (60.0, False), (90.0, False)])
def test_only_steep_surfaces_are_walls(angle_deg, is_wall):
    angle = np.deg2rad(angle_deg)
    assert (len(_found(_HALL, normal=(np.cos(angle), 0.0, np.sin(angle)))) > 0) is is_wall


def test_surfaces_without_a_normal_and_few_points_make_no_plan():
    assert _found(_HALL, normal=(0.0, 0.0, 0.0)) == []
    few = _HALL[::20]
    assert len(few) > 50
    assert _found(few) != []
    assert _found(_HALL[::24]) == []


@pytest.mark.parametrize(("places_m", "is_found"), [((0, 2, 6), True), ((0, 2, 8, 20, 24, 34), False)])
def test_half_of_the_walls_must_coincide(places_m, is_found):
    """No two of these walls are as far from each other as two others, so half a turn takes two of them to others."""
    walls = _walls(*(((-20.0, y_m - 17.0), (20.0, y_m - 17.0)) for y_m in places_m))
    assert (_found(walls) != []) is is_found


def test_near_maxima_are_one_pose():
    """Pillars every 1.5 m fit after each shift by that."""
    sides_m = (-3.0, 5.0)
    pillars = _walls(*(((x_m, y_m - 0.2), (x_m, y_m + 0.2)) for y_m in sides_m for x_m in np.arange(-15.0, 16.0, 1.5)))
    found = _found(pillars)
    assert len(found) == 6
    assert all(one.distance_to(other)[0] >= 2.0 for one, other in combinations(found, 2))
    assert any(one.distance_to(other)[0] < 3.5 for one, other in combinations(found, 2))
    assert len(_found(pillars, most=2)) == 2


_PERIOD_M = 7.5
_FLAT = np.stack(np.meshgrid(np.arange(-40.0, 40.0, 0.5), np.arange(-8.0, 8.0, 0.5), [-1.8]), axis=-1).reshape(-1, 3)


def _row(xs_m, height_m=2.0, sides_m=(-5.0, 4.0)):
    """Sample thin posts, each by a probe per quarter of a metre, on both sides of a road."""
    levels_m = np.arange(-1.8, height_m - 1.8, 0.25)
    return np.array([(x_m, y_m, z_m) for x_m in xs_m for y_m in sides_m for z_m in levels_m])


def _sides(standing_m, ground_m=_FLAT, seen_m=None):
    """Let both LiDARs see the same things on flat ground, unless the source sees others."""
    seen_m = standing_m if seen_m is None else seen_m
    points_m, also_m = (np.concatenate([ground_m, each]) for each in (standing_m, seen_m))
    normals, of_source = np.zeros_like(points_m), np.zeros_like(also_m)
    normals[: len(ground_m)] = of_source[: len(ground_m)] = _UP
    target = SimpleNamespace(probes_m=points_m, normals=normals)
    source = SimpleNamespace(probes_m=_POSE.inverse().apply(also_m), normals=_POSE.inverse().rotate(of_source))
    return [(RigidTransform.identity("t", "t"), target)], [(RigidTransform.identity("s", "s"), source)]


def _repeated(standing_m, max_baseline_m=_FAR_M, up=_UP, ground_m=_FLAT, seen_m=None):
    sides = _sides(standing_m, ground_m, seen_m)
    return repeated_hypotheses(*sides, Hypothesis(_POSE, origin="cliques", index=3), up, max_baseline_m)


@pytest.mark.parametrize("up", [_UP, -_UP], ids=["up", "down"])
def test_a_row_of_equal_things_repeats_to_both_sides(up):
    found = _repeated(_row(np.arange(-30.0, 31.0, _PERIOD_M)), up=up)
    shifts_m = np.array([each.T_target_source.xyz_m - _POSE.xyz_m for each in found])
    assert {round(x_m / _PERIOD_M) for x_m in shifts_m[:, 0]} >= {-2, -1, 1, 2}
    np.testing.assert_allclose(shifts_m[:, 0] / _PERIOD_M, np.rint(shifts_m[:, 0] / _PERIOD_M), atol=0.1)
    np.testing.assert_allclose(shifts_m[:, 1:], 0.0, atol=0.75)
    assert all(each.T_target_source.distance_to(_POSE)[1] < 1e-6 for each in found)
    assert all(one.T_target_source.distance_to(other.T_target_source)[0] > 2.0 for one, other in combinations(found, 2))
    assert {(each.origin, each.index) for each in found} == {("cliques", 3)}
    assert all(each.derivation.startswith("repeated after ") for each in found)


def test_repeated_poses_beyond_the_baseline_are_none():
    found = _repeated(_row(np.arange(-30.0, 31.0, _PERIOD_M)), max_baseline_m=9.5)
    assert 0 < len(found) < len(_repeated(_row(np.arange(-30.0, 31.0, _PERIOD_M))))
    assert all(np.linalg.norm(each.T_target_source.xyz_m) <= 9.5 for each in found)


def test_far_repetitions_do_not_crowd_out_those_on_the_vehicle():
    """Posts on both sides of a road fit best where the target sees both sides, far ahead."""
    near, ahead = np.arange(-30.0, 31.0, _PERIOD_M), np.arange(30.0, 61.0, _PERIOD_M)
    seen = np.concatenate([_row(near, sides_m=[-5.0]), _row(ahead)])
    found = _repeated(seen, max_baseline_m=9.5, seen_m=_row(np.arange(-15.0, 16.0, _PERIOD_M)))
    assert {round((each.T_target_source.xyz_m - _POSE.xyz_m)[0] / _PERIOD_M) for each in found} >= {-1, 1}


def test_the_opposite_of_a_shift_off_the_vehicle_counts():
    """The row goes on ahead only: after a shift to the rear, a third of what the source sees has no counterpart."""
    seen = np.arange(-_PERIOD_M, 1.5 * _PERIOD_M, _PERIOD_M)
    ahead = _row(np.arange(-_PERIOD_M, 61.0, _PERIOD_M), height_m=3.0)
    found = _repeated(ahead, max_baseline_m=_PERIOD_M, seen_m=_row(seen, height_m=3.0))
    assert [round((each.T_target_source.xyz_m - _POSE.xyz_m)[0] / _PERIOD_M) for each in found] == [-1]


def test_single_things_do_not_repeat():
    posts = [_row([-22.0, -9.0, 12.5], sides_m=[-5.0]), _row([-3.0, 8.0, 29.0], sides_m=[4.0])]
    assert _repeated(np.concatenate(posts)) == []


def test_a_ceiling_does_not_hide_what_stands_below_it():
    roofed_m = np.concatenate([_FLAT, _FLAT + np.array([0.0, 0.0, 4.0])])
    row, posts = _row(np.arange(-30.0, 31.0, _PERIOD_M)), _row([-22.0, -9.0, 12.5], sides_m=[-5.0])
    below, open_air = (_repeated(row, ground_m=ground_m) for ground_m in (roofed_m, _FLAT))
    assert [each.derivation for each in below] == [each.derivation for each in open_air]
    assert _repeated(posts, ground_m=roofed_m) == []


def test_what_lies_on_the_ground_does_not_stand():
    assert _repeated(_row(np.arange(-30.0, 31.0, _PERIOD_M), height_m=0.3)) == []


def _side(normals):
    view = SimpleNamespace(normals=np.asarray(normals, dtype=float), probes_m=np.zeros((len(normals), 3)))
    return [(RigidTransform.identity("t", "t"), view)]


def _axes(counts, spread=0.0):
    """Of surfaces that face north, east, up or (0.6, 0.8, 0), as many as are given, for two sides that share them."""
    rng = np.random.default_rng(4)
    normals = np.repeat([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], _UP, [0.6, 0.8, 0.0]], counts, axis=0)
    normals = normals * rng.choice([-1.0, 1.0], size=(len(normals), 1)) + spread * rng.normal(size=normals.shape)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    return main_axes(_side(normals[::2]), _side(_POSE.inverse().rotate(normals[1::2])), _POSE)


@pytest.mark.parametrize("spread", [0.0, 0.03])
def test_walls_as_common_as_the_ground_do_not_hide_it(spread):
    """The principal direction of all normals would be any between them."""
    axes = np.abs(_axes([500, 500, 500, 0], spread))
    assert np.allclose(axes[np.argsort(np.argmax(axes, axis=1))], np.eye(3), atol=0.02)


def test_the_commonest_axis_is_the_first():
    assert np.allclose(np.abs(_axes([300, 100, 200, 0])), [[0.0, 1.0, 0.0], _UP, [1.0, 0.0, 0.0]], atol=1e-6)


def test_rare_axes_and_those_beside_another_are_none():
    assert len(_axes([300, 20, 200, 0])) == 2
    assert len(_axes([300, 0, 200, 100])) == 2
    assert _axes([0, 0, 0, 0]) == []


def test_shifts_that_leave_little_in_common_are_found():
    """Of six things, three have a counterpart three steps farther."""
    row = _row(np.arange(0.0, 6.0 * _PERIOD_M, _PERIOD_M))
    steps = {round((each.xyz_m - _POSE.xyz_m)[0] / _PERIOD_M) for each in shifted_poses(*_sides(row), _POSE, _FAR_M)}
    assert steps >= {-3, -2, -1, 1, 2, 3}
    assert not {round((each.T_target_source.xyz_m - _POSE.xyz_m)[0] / _PERIOD_M) for each in _repeated(row)} & {-3, 3}


def test_without_standing_things_no_shift_is_tested():
    assert shifted_poses(*_sides(_row([3.0], height_m=0.5)), _POSE, _FAR_M) is None
