# SPDX-License-Identifier: Apache-2.0
"""Links with too little evidence count where others confirm them."""

from dataclasses import replace

import numpy as np
import pytest

from multilica.multi_snapshot.view_solution import solve_views
from multilica.multi_snapshot.weak_links import confirmed_links
from tests.multi_snapshot.made_drive import LIDARS, pair, pairs

_SURE = "A1-A2 A2-A3 A1-A3"
_OFF = [0.0, 0.0, 0.0, 0.0, 5.0, 0.0]


def _links(text, seed=0):
    return pairs(text, np.random.default_rng(seed))


def test_two_weak_links_confirm_each_other():
    sure, weak = _links(_SURE), _links("A1-B3 A3-B1", 1)
    assert confirmed_links("A", [], sure, weak) == weak
    told = solve_views("A", [*sure, *weak]).poses.poses["B"]
    assert np.linalg.norm(told.offset_from(LIDARS["B"])[3:]) < 0.02


@pytest.mark.parametrize(
    "weak",
    [[], ["A1-B3"], [("A1-B3", _OFF), "A3-B1"]],
    ids=["none", "one, which nothing confirms", "two that contradict each other"],
)
def test_others_do_not_count(weak):
    made = [
        pair(*each.split("-")) if isinstance(each, str) else pair(*each[0].split("-"), off=each[1]) for each in weak
    ]
    assert confirmed_links("A", [], _links(_SURE), made) == []


def test_a_wrong_weak_link_is_left_out():
    wrong = pair("A2", "B1", off=_OFF)
    right = _links("A1-B3 A3-B1 A2-B3", 1)
    found = confirmed_links("A", [], _links(_SURE), [wrong, *right])
    assert len(found) == 3
    assert wrong not in found


def test_weak_links_tell_nothing_beside_contradictions():
    sure = [*_links(_SURE), pair("A3", "A1", off=_OFF)]
    assert confirmed_links("A", [], sure, _links("A1-B3 A3-B1", 1)) == []


def test_weak_links_add_to_poses_that_are_told():
    sure = _links(f"{_SURE} A2-B2 A3-B3")
    right, wrong = _links("A1-B3 A3-B1", 1), pair("A2", "B1", off=_OFF)
    assert confirmed_links("A", [], sure, [*right, wrong]) == right


def test_a_link_of_a_lidar_without_a_pose_is_not_confirmed():
    """Motions of the LiDARs may leave one without a pose that links alone gave one."""
    sure, (link,) = _links(_SURE), _links("A1-B3", 1)
    assert not solve_views("A", sure).is_confirmed(link)
    assert solve_views("A", sure).is_confirmed(sure[0])


def test_contradiction_along_one_direction_confirms_nothing():
    """A second link tells one coordinate only, and another one than the first does."""
    link, other = pair("A1", "A2"), pair("A1", "A2", off=[0.0, 0.0, 0.0, 0.1, 0.0, 0.0])
    along_x = replace(other.registration, information=np.diag([0.0, 0.0, 0.0, 1e6, 0.0, 0.0]))
    assert not solve_views("A", [link, replace(other, registration=along_x)]).is_confirmed(link)
