# SPDX-License-Identifier: Apache-2.0
"""Which objects of a made place are labelled as movable."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.registration.movable import find_movable

_LIDARS_M = np.array([[0.0, 0.0, 2.0], [1.0, 0.0, 2.0]])
_LEVEL = np.eye(3)
_SPACING_M = 0.2


def _box(lowest_m, highest_m):
    """Points on a grid that fill a box."""
    axes = [np.arange(low, high + 1e-9, _SPACING_M) for low, high in zip(lowest_m, highest_m, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


_GROUND = _box((-30.0, -30.0, 0.0), (30.0, 30.0, 0.0))
_CAR = _box((8.0, 3.0, 0.2), (12.4, 4.8, 1.5))
_PERSON = _box((5.0, -4.0, 0.1), (5.2, -3.6, 1.7))
_LORRY = _box((-15.0, 5.0, 0.4), (1.0, 7.4, 3.9))
_WALL = _box((-20.0, 9.0, 0.0), (20.0, 9.2, 6.0))
_RAIL = _box((-25.0, -8.0, 0.5), (25.0, -7.8, 0.8))
_TREE = np.concatenate([_box((6.0, 6.0, 0.0), (6.2, 6.2, 3.0)), _box((5.0, 5.0, 3.0), (7.4, 7.4, 7.0))])
_POST = _box((4.0, -6.0, 0.0), (4.0, -6.0, 1.2))
_SIGN = _box((6.0, -2.0, 5.0), (6.0, 2.0, 6.0))
_LOW_WALL = _box((-6.0, -6.0, 0.0), (6.0, -5.8, 1.0))
# The land below a bridge, the side of its deck, and a railing on it: y from and to, z from and to.
_EDGE = ((6.4, 30.0, -6.0, -6.0), (6.4, 6.4, -1.2, 0.0), (6.2, 6.2, 0.0, 1.2))


def _share(thing_m, *beside, lidars_m=_LIDARS_M, rotation=_LEVEL):
    """Share of the points of a thing on movable objects."""
    points_m = np.concatenate([_GROUND, thing_m, *beside]) @ rotation
    cells = find_movable(points_m, lidars_m @ rotation, [rotation])
    return float(cells.contain(thing_m @ rotation).mean())


@pytest.mark.parametrize("thing_m", [_CAR, _PERSON, _LORRY], ids=["car", "person", "lorry"])
def test_vehicles_and_people_are_movable(thing_m):
    assert _share(thing_m) > 0.95


@pytest.mark.parametrize(
    "thing_m", [_WALL, _RAIL, _TREE, _POST, _SIGN, _LOW_WALL], ids=["wall", "rail", "tree", "post", "sign", "low wall"]
)
def test_what_is_built_or_grows_is_not(thing_m):
    assert _share(thing_m) == 0.0


def test_far_ground_is_not_movable():
    away = np.linalg.norm(_GROUND[:, :2] - [10.2, 3.9], axis=1) > 4.0
    assert find_movable(np.concatenate([_GROUND, _CAR]), _LIDARS_M, [_LEVEL]).contain(_GROUND[away]).sum() == 0


def test_a_car_under_a_ceiling_is_movable():
    assert _share(_CAR, _box((-30.0, -30.0, 2.6), (30.0, 30.0, 2.6))) > 0.95


def test_the_edge_of_a_bridge_does_not_tie_a_car_to_its_railing():
    below_m, face_m, railing_m = (_box((-30.0, y, low), (30.0, end, high)) for y, end, low, high in _EDGE)
    deck_m = _GROUND[_GROUND[:, 1] < 6.4]
    points_m = np.concatenate([deck_m, below_m, face_m, railing_m, _CAR])
    cells = find_movable(points_m, _LIDARS_M, [_LEVEL])
    assert cells.contain(_CAR).mean() > 0.95
    assert cells.contain(railing_m).sum() == 0


def test_a_car_above_land_is_movable():
    """Nobody sees the road of a bridge about a part of the car: the land below shows through."""
    hidden = (np.abs(_GROUND[:, 0] - 14.0) < 4.0) & (np.abs(_GROUND[:, 1] - 4.0) < 5.0)
    land_m = _box((10.0, -2.0, -15.0), (18.0, 10.0, -15.0))
    cells = find_movable(np.concatenate([_GROUND[~hidden], land_m, _CAR]), _LIDARS_M, [_LEVEL])
    assert cells.contain(_CAR).mean() > 0.9


def test_what_touches_a_wall_belongs_to_it():
    assert _share(_CAR, _box((-20.0, 5.0, 0.0), (20.0, 5.2, 4.0))) == 0.0


def test_the_vehicle_that_carries_the_lidars_is_not_movable():
    assert _share(_CAR, lidars_m=np.array([[10.0, 4.0, 1.9]])) == 0.0


def test_a_tilted_frame_is_levelled():
    assert _share(_CAR, rotation=Rotation.from_euler("xyz", [0.2, -0.3, 0.5]).as_matrix()) > 0.95


@pytest.mark.parametrize(("thing_m", "share"), [(_CAR, 1.0), (_WALL, 0.0)], ids=["car", "wall"])
def test_any_of_several_verticals_counts(thing_m, share):
    """Upside down, all things hang together with the ground, which stands above the ceiling."""
    ceiling_m, over = _box((-30.0, -30.0, 2.6), (30.0, 30.0, 2.6)), np.diag([1.0, -1.0, -1.0])
    points_m = np.concatenate([_GROUND, thing_m[thing_m[:, 2] < 2.4], ceiling_m])
    assert not find_movable(points_m, _LIDARS_M, [over]).contain(points_m).any()
    cells = find_movable(points_m, _LIDARS_M, [over, _LEVEL])
    assert cells.contain(thing_m).mean() == pytest.approx(share, abs=0.05)


def test_nothing_but_ground_has_no_movable_cells():
    assert find_movable(_GROUND, _LIDARS_M, [_LEVEL]).is_empty


def test_points_out_of_range_alone_have_no_movable_cells():
    assert find_movable(_GROUND + 500.0, _LIDARS_M, [_LEVEL]).is_empty


@pytest.mark.parametrize(
    ("moving_m", "moved"),
    [
        (_CAR + np.array([0.8, 0.0, 0.0]), True),
        (_CAR[:3] + np.array([0.0, 0.1, 0.0]), False),
        (_CAR + np.array([0.0, 6.0, 0.0]), False),
        (np.empty((0, 3)), False),
    ],
    ids=["crept", "edges", "another", "nothing"],
)
def test_a_car_moved_if_as_much_as_a_third_of_it_did(moving_m, moved):
    cells = find_movable(np.concatenate([_GROUND, _CAR, _PERSON]), _LIDARS_M, [_LEVEL], moving_m)
    assert cells.contain(_CAR).mean() > 0.95
    assert (cells.of_moved.contain(_CAR).mean() > 0.95) == cells.has_moved == moved
    assert not cells.of_moved.contain(_PERSON).any()


def test_what_is_built_has_not_moved():
    cells = find_movable(np.concatenate([_GROUND, _WALL]), _LIDARS_M, [_LEVEL], _WALL + np.array([0.3, 0.0, 0.0]))
    assert cells.of_moved.is_empty
    assert not cells.has_moved
