# SPDX-License-Identifier: Apache-2.0
import pytest

from multilica.results import Group
from multilica.stages.loops import open_loops
from tests.unit.made_pairs import ACCEPTED, pair, pose, undecided

_PLACED = pose("a", "b", (1.0, 0.0, 0.0))
_ELSEWHERE = pose("a", "b", (0.0, 4.0, 0.0))
_RIG = Group("a", {"a": pose("a", "a"), "b": _PLACED})


@pytest.mark.parametrize(
    ("before", "is_open"),
    [
        (pair(_PLACED, undecided("not_observable")), False),
        (pair(_PLACED.inverse(), undecided("not_observable")), False),
        (pair(_ELSEWHERE, undecided("not_observable")), True),
        (pair(_PLACED, undecided("ambiguous")), True),
        (pair(_PLACED, undecided("ambiguous", "not_observable")), True),
        (pair(_PLACED, ACCEPTED), False),
        (None, True),
    ],
    ids=["unconstrained there", "the other way round", "elsewhere", "ambiguous", "both", "accepted", "no registration"],
)
def test_a_loop_is_open_unless_the_scene_refused_its_pose(before, is_open):
    loops = open_loops(_RIG, [("a", "b")], {} if before is None else {("a", "b"): before})
    assert list(loops) == ([("a", "b")] if is_open else [])
    assert all(implied.distance_to(_PLACED) == pytest.approx((0.0, 0.0)) for implied in loops.values())


def test_the_pose_of_a_loop_is_that_of_the_rig():
    third = pose("a", "c", (0.0, 2.0, 0.0), 0.5)
    rig = Group("a", {**_RIG.poses, "c": third})
    registrations = {("a", "b"): pair(_PLACED), ("a", "c"): pair(third)}
    loops = open_loops(rig, [("a", "b"), ("a", "c"), ("b", "c")], registrations)
    assert list(loops) == [("b", "c")]
    assert loops["b", "c"].distance_to(_PLACED.inverse() @ third) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_lidar_that_is_not_placed_has_no_loop():
    assert open_loops(_RIG, [("a", "c"), ("b", "c")], {}) == {}
