# SPDX-License-Identifier: Apache-2.0
"""LiDARs that objects which moved, or may have, hold: sigma with the shift, and other places that look alike."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from multilica.config import CalibrationConfig
from multilica.orchestration import movable
from multilica.orchestration.movable import _repetition_of, doubt_movable
from multilica.registration.movable import MovableCells, MovableSpace
from multilica.stages.refine import RefinedRig
from tests.unit.made_pairs import pair, pose, registration

_CONFIG = CalibrationConfig()
_POSES = {"t": pose("t", "t"), "s": pose("t", "s", (1.0, 0.0, 0.0), 0.3), "u": pose("t", "u", (0.0, 2.0, 0.0))}
_HERE = registration(_POSES["s"])
_THERE = replace(registration(pose("t", "s", (1.0, 9.4, 0.0), 0.3)), derivation="repeated after 9.4 m")
_UNLIKELY = replace(_THERE, visibility=replace(_THERE.visibility, violate=60))


def _found(name, *pairs):
    return _repetition_of(name, pairs, _POSES, _CONFIG)


@pytest.mark.parametrize("name", ["s", "t"])
def test_a_repetition_that_is_not_far_less_likely_counts(name):
    offset = _found(name, pair(_POSES["s"], registrations=(_HERE, _THERE)))
    assert np.linalg.norm(offset[3:]) == pytest.approx(9.4)
    assert offset[:3] == pytest.approx(np.zeros(3))
    if name == "s":
        assert offset[3:] == pytest.approx([0.0, 9.4, 0.0])


def test_the_best_pose_may_be_the_repetition():
    found = replace(_HERE, derivation="repeated after 9.4 m"), replace(_THERE, derivation="")
    assert _found("s", pair(_POSES["s"], registrations=found)) is not None


@pytest.mark.parametrize(
    "registrations",
    [(), (_HERE,), (_HERE, _UNLIKELY), (_HERE, replace(_THERE, derivation="turned by 180 deg"))],
    ids=["none", "no other", "far less likely", "no repetition"],
)
def test_other_poses_do_not(registrations):
    assert _found("s", pair(_POSES["s"], registrations=registrations)) is None


def test_a_second_pair_tells_both_places_apart():
    alone, second = pair(_POSES["s"], registrations=(_HERE, _THERE)), pair(pose("s", "u"))
    assert _found("s", alone, second) is None
    assert _found("s", alone, pair(pose("t", "u"))) is not None


@pytest.mark.parametrize(("sigma_m", "is_held"), [(0.03, True), (0.004, False)])
def test_the_shift_widens_what_moved_objects_hold(monkeypatch, sigma_m, is_held):
    """The fit may have stopped between where they and the fixed objects put it. What fixed objects hold is sure."""
    known = pair(_POSES["s"])
    of_all, of_fixed = (np.diag([1e-8] * 3 + [sigma**2] * 3) for sigma in (0.002, sigma_m))
    rig = RefinedRig({"t": _POSES["t"], "s": _POSES["s"]}, {"s": of_all}, {}, None)
    there = replace(rig, poses={**rig.poses, "s": pose("t", "s", (1.1, 0.0, 0.0), 0.3)}, covariances={"s": of_fixed})
    cells = MovableSpace((MovableCells(np.eye(3), np.array([1]), np.array([1])),))
    for name, made in (
        ("_moving_points", np.ones((1, 3))),
        ("_movable_cells", cells),
        ("_show_movable", None),
        ("_without_movable", {id(known): known}),
        ("refine", there),
    ):
        monkeypatch.setattr(movable, name, lambda *_, made=made: made)
    state = SimpleNamespace(snapshot=SimpleNamespace(lidars=()), lidars={}, config=_CONFIG, target="t", held={})
    found = doubt_movable(state, rig, [known])
    assert found.poses is there.poses
    assert ("s" in state.held) == is_held
    widened = np.zeros((6, 6))
    widened[3, 3] = 0.1**2 if is_held else 0.0
    np.testing.assert_allclose(found.covariances["s"], of_fixed + widened, atol=1e-9)


def test_what_moved_and_what_can_move_are_left_out_apart():
    """The pairs of one LiDAR share what is fixed of it, unless only the others have several frames."""
    cells = MovableSpace((MovableCells(np.eye(3), np.array([1, 2]), np.array([1])),))
    known = pair(_POSES["s"])
    of_movable, of_moved, again = (
        {each.target, each.source}
        for each in (movable._request(known, of) for of in (cells, cells.of_moved, cells.of_moved))
    )
    assert of_moved == again
    assert of_moved.isdisjoint(of_movable)
