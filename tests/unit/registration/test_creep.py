# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.geometry import LEVER_ARM_M, RigidTransform
from multilica.registration.creep import Creep
from multilica.registration.poses import moved

_BEGIN = RigidTransform.from_xyz_rpy("t", "s", [3.0, -1.0, 0.5], [0.1, -0.2, 0.7])


def _at(way):
    """The pose after a way (6,): arcs at the lever arm, then a shift."""
    return moved(_BEGIN, np.asarray(way[:3]) / LEVER_ARM_M, np.asarray(way[3:]))


def _path(direction, *ways_m):
    return [_at(way_m * np.asarray(direction)) for way_m in ways_m]


_ALONG = np.array([0.0, 0.0, 0.0, 0.6, 0.0, 0.8])
_TURN = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("direction", [_ALONG, _TURN, (_ALONG + _TURN) / np.sqrt(2.0)], ids=["shift", "turn", "both"])
def test_motions_that_shrink_lead_to_their_limit(direction):
    creep = Creep()
    poses = _path(direction, 0.0, 0.04, 0.07)
    assert creep.leap(*poses[:2], longest_m=1.0) is poses[1]
    reached = creep.leap(*poses[1:], longest_m=1.0)
    metres, radians = reached.distance_to(_at(0.16 * direction))
    assert metres < 1e-6
    assert radians < 1e-7


def test_the_way_includes_the_last_leap():
    """Each motion is a tenth of the way left: the second leap corrects the first, which was cut."""
    creep, ends_m = Creep(), []
    at_m = 0.0
    for _ in range(5):
        moved_m = at_m + 0.1 * (1.0 - at_m)
        pose = creep.leap(_at(at_m * _ALONG), _at(moved_m * _ALONG), longest_m=0.3)
        at_m = float((pose.xyz_m - _BEGIN.xyz_m) @ _ALONG[3:])
        ends_m.append(at_m)
    assert ends_m == pytest.approx([0.1, 0.49, 0.841, 1.0, 1.0])


@pytest.mark.parametrize("second_m", [0.04, 0.06], ids=["as long", "longer"])
def test_motions_that_do_not_shrink_lead_far_ahead(second_m):
    creep, poses = Creep(), _path(_ALONG, 0.0, 0.04, 0.04 + second_m)
    creep.leap(*poses[:2], longest_m=9.0)
    assert creep.leap(*poses[1:], longest_m=9.0).distance_to(poses[2])[0] == pytest.approx(10.0 * second_m)


def test_no_leap_is_longer_than_asked_for():
    creep, poses = Creep(), _path(_ALONG, 0.0, 0.04, 0.0799)
    creep.leap(*poses[:2], longest_m=0.25)
    assert creep.leap(*poses[1:], longest_m=0.25).distance_to(poses[2])[0] == pytest.approx(0.25)


@pytest.mark.parametrize("then", [-_ALONG, _TURN, 0.0 * _ALONG], ids=["back", "aside", "not at all"])
def test_without_a_direction_there_is_no_leap(then):
    creep, first = Creep(), 0.04 * _ALONG
    creep.leap(_BEGIN, _at(first), longest_m=1.0)
    after = _at(first + 0.03 * then)
    assert creep.leap(_at(first), after, longest_m=1.0) is after
