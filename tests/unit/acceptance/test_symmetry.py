# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from multilica.acceptance.symmetry import check_scene_symmetry
from multilica.config import AcceptanceConfig
from multilica.geometry import RigidTransform
from multilica.results import PairRegistration, Registration, Verdict, VisibilityScore

_CONFIG = AcceptanceConfig()
# The hall looks the same turned about the point (2, 0) of the first LiDAR's frame.
_SYMMETRY = RigidTransform.from_xyz_rpy("a", "a", [4.0, 0.0, 0.0], [0.0, 0.0, np.pi])


def _pose(target, source, x_m=1.0, yaw_rad=0.3):
    return RigidTransform.from_xyz_rpy(target, source, [x_m, 0.2, 0.0], [0.0, 0.0, yaw_rad])


def _registration(pose, agree=1000, violate=0):
    information = np.diag([50.0, 200, 200, 200, 200, 400])
    score = VisibilityScore(agree, violate, 0, 0, information, np.zeros(0, dtype=np.uint8))
    return Registration(0, pose, score, 0.8, 0.03, 5.0, np.zeros((0, 3)))


def _pair(pose, competing=None, verdict=Verdict("accept")):  # noqa: B008
    pair = PairRegistration(
        pose.target, pose.source, pose, 0.9, 0.1, 10, converged=True, iterations=3, engine="test", verdict=verdict
    )
    return replace(pair, registrations=tuple(_registration(each) for each in (pose, competing) if each is not None))


def _ambiguous(pose, competing):
    return _pair(pose, competing, Verdict("undecided"))


@pytest.mark.parametrize("known_as", ["target", "source"])
@pytest.mark.parametrize("seen_as", ["target", "source"])
def test_a_pair_whose_turned_pose_is_possible_is_doubted(known_as, seen_as):
    seen, accepted = _pose("a", "b"), _pose("a", "c", x_m=-1.0)
    symmetric = _ambiguous(seen, _SYMMETRY @ seen)
    if seen_as == "source":
        symmetric = _ambiguous(seen.inverse(), (_SYMMETRY @ seen).inverse())
    pair = _pair(accepted if known_as == "target" else accepted.inverse())
    scored = []

    def score_pose(pose):
        scored.append(_registration(pose, agree=0))
        return scored[-1]

    doubted = check_scene_symmetry([symmetric, pair], score_pose, _CONFIG)
    assert doubted[0] is symmetric
    assert doubted[1].verdict.outcome == "undecided"
    assert [reason.code for reason in doubted[1].verdict.reasons] == ["ambiguous"]
    assert "when turned by 180 deg" in doubted[1].verdict.reasons[0].text
    turned = _SYMMETRY @ accepted
    expected = turned if known_as == "target" else turned.inverse()
    assert doubted[1].competing is scored[0]
    assert scored[0].T_target_source.distance_to(expected) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_pair_whose_turned_pose_is_impossible_is_kept():
    seen = _pose("a", "b")
    pairs = [_ambiguous(seen, _SYMMETRY @ seen), _pair(_pose("a", "c", x_m=-1.0))]
    assert check_scene_symmetry(pairs, lambda pose: _registration(pose, agree=900, violate=100), _CONFIG)[1] is pairs[1]


def test_a_slide_is_no_symmetry():
    seen = _pose("a", "b")
    slid = RigidTransform.from_xyz_rpy("a", "a", [0.0, 3.0, 0.0], [0.0, 0.0, 0.0]) @ seen
    pairs = [_ambiguous(seen, slid), _pair(_pose("a", "c", x_m=-1.0))]
    assert check_scene_symmetry(pairs, _registration, _CONFIG)[1] is pairs[1]
