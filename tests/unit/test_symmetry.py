# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from multilica import testimony
from multilica.config import VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import Assessment, PairRegistration, Verdict
from multilica.stages.symmetry import doubt_by_symmetry

_CONFIG = VerifyConfig()
# The hall looks the same turned about the point (2, 0) of the first LiDAR's frame.
_SYMMETRY = RigidTransform.from_xyz_rpy("a", "a", [4.0, 0.0, 0.0], [0.0, 0.0, np.pi])


def _pose(target, source, x_m=1.0, yaw_rad=0.3):
    return RigidTransform.from_xyz_rpy(target, source, [x_m, 0.2, 0.0], [0.0, 0.0, yaw_rad])


def _testimony(agree=1000, violate=0):
    return testimony.Testimony(
        agree, violate, 0, 0, np.diag([50.0, 200, 200, 200, 200, 400]), np.zeros(0, dtype=np.uint8)
    )


def _assessment(pose):
    return Assessment(0, pose, _testimony(), 0.8, 0.03, 5.0, np.zeros((0, 3)))


def _pair(pose, rival=None, verdict=Verdict("accept")):  # noqa: B008
    pair = PairRegistration(
        pose.target, pose.source, pose, 0.9, 0.1, 10, converged=True, iterations=3, engine="test", verdict=verdict
    )
    return replace(pair, assessments=tuple(_assessment(each) for each in (pose, rival) if each is not None))


def _ambiguous(pose, rival):
    return _pair(pose, rival, Verdict("undecided"))


@pytest.mark.parametrize("known_as", ["target", "source"])
@pytest.mark.parametrize("seen_as", ["target", "source"])
def test_an_accepted_pair_is_doubted_if_its_turned_pose_is_possible(known_as, seen_as):
    seen, accepted = _pose("a", "b"), _pose("a", "c", x_m=-1.0)
    symmetric = _ambiguous(seen, _SYMMETRY @ seen)
    if seen_as == "source":
        symmetric = _ambiguous(seen.inverse(), (_SYMMETRY @ seen).inverse())
    pair = _pair(accepted if known_as == "target" else accepted.inverse())
    asked = []

    def testify(rival):
        asked.append(rival)
        return _testimony(agree=0)

    doubted = doubt_by_symmetry([symmetric, pair], testify, _CONFIG)
    assert doubted[0] is symmetric
    assert doubted[1].verdict.outcome == "undecided"
    assert [reason.code for reason in doubted[1].verdict.reasons] == ["ambiguous"]
    assert "turned by 180 deg" in doubted[1].verdict.reasons[0].text
    turned = _SYMMETRY @ accepted
    expected = turned if known_as == "target" else turned.inverse()
    assert asked[0].distance_to(expected) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_pair_whose_turned_pose_beams_contradict_stays_accepted():
    seen = _pose("a", "b")
    pairs = [_ambiguous(seen, _SYMMETRY @ seen), _pair(_pose("a", "c", x_m=-1.0))]
    assert doubt_by_symmetry(pairs, lambda *_: _testimony(agree=900, violate=100), _CONFIG)[1] is pairs[1]


def test_a_slide_is_no_symmetry():
    seen = _pose("a", "b")
    slid = RigidTransform.from_xyz_rpy("a", "a", [0.0, 3.0, 0.0], [0.0, 0.0, 0.0]) @ seen
    pairs = [_ambiguous(seen, slid), _pair(_pose("a", "c", x_m=-1.0))]
    assert doubt_by_symmetry(pairs, lambda *_: _testimony(), _CONFIG)[1] is pairs[1]
