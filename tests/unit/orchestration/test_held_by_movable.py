# SPDX-License-Identifier: Apache-2.0
"""Other places of a LiDAR that objects which may have moved hold, in a scene that repeats."""

from dataclasses import replace

import numpy as np
import pytest

from multilica.config import CalibrationConfig
from multilica.orchestration.movable import _repetition_of
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
