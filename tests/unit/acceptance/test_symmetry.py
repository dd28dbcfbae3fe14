# SPDX-License-Identifier: Apache-2.0
"""Symmetries of the scene that take an accepted pair to another possible pose."""

from dataclasses import replace

import numpy as np
import pytest

from multilica.acceptance.rig import check_scene_symmetry
from multilica.config import AcceptanceConfig
from tests.unit.acceptance.made_rig import registered, scored
from tests.unit.made_pairs import ACCEPTED, UNCERTAIN, pair, pose, undecided

_CONFIG = AcceptanceConfig()
# The hall looks the same turned about the point (2, 0) of the first LiDAR's frame.
_SYMMETRY = pose("a", "a", (4.0, 0.0, 0.0), np.pi)
_SEEN, _OTHER = pose("a", "b", (1.0, 0.2, 0.0), 0.3), pose("a", "c", (-1.0, 0.2, 0.0), 0.3)


def _symmetric(turned_by=_SYMMETRY):
    return registered(_SEEN, verdict=undecided("ambiguous"), competing=[turned_by @ _SEEN])


def _unseen(at):
    return scored(at, 0)


@pytest.mark.parametrize("verdict", [ACCEPTED, UNCERTAIN], ids=["accepted", "uncertain"])
@pytest.mark.parametrize("known_as", ["target", "source"])
@pytest.mark.parametrize("seen_as", ["target", "source"])
def test_a_pair_whose_turned_pose_is_possible_is_doubted(known_as, seen_as, verdict):
    symmetric = _symmetric()
    if seen_as == "source":
        turned = (_SYMMETRY @ _SEEN).inverse()
        symmetric = registered(_SEEN.inverse(), verdict=undecided("ambiguous"), competing=[turned])
    accepted = registered(_OTHER if known_as == "target" else _OTHER.inverse(), verdict=verdict)
    doubted = check_scene_symmetry([symmetric, accepted], _unseen, _CONFIG)
    assert doubted[0] is symmetric
    assert doubted[1].verdict.outcome == "undecided"
    assert doubted[1].verdict.codes == ("ambiguous",)
    assert "when turned by 180 deg" in doubted[1].verdict.text
    expected = _SYMMETRY @ _OTHER if known_as == "target" else (_SYMMETRY @ _OTHER).inverse()
    assert doubted[1].competing.T_target_source.distance_to(expected) == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(("by_pair", "doubted"), [(0, True), (2, True), (20, False)])
def test_a_turned_pose_that_beams_contradict_is_none(by_pair, doubted):
    pairs = [_symmetric(), registered(_OTHER)]
    after = check_scene_symmetry(pairs, lambda at: scored(at, 100, by_pair), _CONFIG)
    assert (after[1] is not pairs[1]) is doubted


def test_the_inverse_of_a_symmetry_is_one_too():
    """A court looks the same turned by 90 deg; of both turned poses, beams contradict one."""
    quarter = pose("a", "a", (2.0, 2.0, 0.0), np.pi / 2.0)
    pairs = [_symmetric(quarter), registered(_OTHER)]
    right = quarter.inverse() @ _OTHER

    def score(at):
        return scored(at, 0, violate=0 if at.distance_to(right)[0] < 0.1 else 90)

    after = check_scene_symmetry(pairs, score, _CONFIG)
    assert after[1].competing.T_target_source.distance_to(right) == pytest.approx((0.0, 0.0), abs=1e-9)


@pytest.mark.parametrize(("distinctive", "doubted"), [(8000, True), (0, False)])
def test_a_turned_pose_that_is_as_likely_competes(distinctive, doubted):
    """Things in a hall may contradict its symmetry, and both poses be possible all the same."""
    pairs = [_symmetric(), registered(_OTHER)]
    assert scored(_OTHER, distinctive, violate=30).visibility.contradiction > _CONFIG.min_log_odds_margin
    after = check_scene_symmetry(pairs, lambda at: scored(at, distinctive, violate=30), _CONFIG)
    assert ("when turned by 180 deg" in after[1].verdict.text) is doubted


@pytest.mark.parametrize(
    "motion",
    [pose("a", "a", (0.0, 3.0, 0.0)), pose("a", "a", (40.0, 0.0, 0.0), np.pi)],
    ids=["a slide", "beyond the baseline"],
)
def test_what_is_no_symmetry_is_ignored(motion):
    pairs = [_symmetric(motion), registered(_OTHER)]
    assert check_scene_symmetry(pairs, _unseen, _CONFIG)[1] is pairs[1]


def test_a_pose_with_much_less_evidence_shows_no_symmetry():
    seen = registered(_SEEN)
    seen = replace(seen, registrations=(*seen.registrations, scored(_SYMMETRY @ _SEEN, 20)))
    pairs = [seen, registered(_OTHER)]
    assert check_scene_symmetry(pairs, _unseen, _CONFIG) == pairs


def test_two_wrong_poses_show_no_symmetry():
    poses = _SEEN, _SYMMETRY @ _SEEN
    refused = pair(_SEEN, undecided("ambiguous"), registrations=tuple(scored(each, violate=200) for each in poses))
    assert refused.evidence < 0.0
    pairs = [refused, registered(_OTHER)]
    assert check_scene_symmetry(pairs, _unseen, _CONFIG) == pairs


@pytest.mark.parametrize("joined", [True, False], ids=["joined", "apart"])
@pytest.mark.parametrize(("violate", "possible"), [(0, True), (90, False)])
def test_joined_lidars_stand_in_the_same_hall(joined, violate, possible):
    """The pair that sees the symmetry has no LiDAR of the doubted pair; another one joins them."""
    away, there = pose("a", "d", (0.5, -0.4, 0.0), -1.0), pose("d", "e", (-1.0, 0.2, 0.0), 0.3)
    pairs = [_symmetric(), registered(there), *([registered(away, distinctive=5000)] if joined else [])]
    right = away.inverse() @ _SYMMETRY @ away @ there

    def score(at):
        return scored(at, 0, violate=violate if at.distance_to(right)[0] < 0.1 else 90)

    after = check_scene_symmetry(pairs, score, _CONFIG)
    assert (after[1].verdict.outcome == "undecided") is (joined and possible)
    if joined and possible:
        assert after[1].competing.T_target_source.distance_to(right) == pytest.approx((0.0, 0.0), abs=1e-9)


def test_a_repetition_that_other_lidars_see_doubts_no_pair():
    away, there = pose("a", "d", (0.5, -0.4, 0.0), -1.0), pose("d", "e", (-1.0, 0.2, 0.0), 0.3)
    pairs = [_symmetric(pose("a", "a", (6.0, 0.0, 0.0))), registered(there), registered(away)]
    after = check_scene_symmetry(pairs, lambda at: scored(at, 550), _CONFIG)
    assert after[1] is pairs[1]


@pytest.mark.parametrize(
    ("distinctive", "confirmed", "doubted"), [(550, False, True), (0, False, False), (550, True, False)]
)
def test_a_repetition_of_the_scene_competes_with_lone_pairs(distinctive, confirmed, doubted):
    """In a tunnel, a pair took one niche for the next. Another pair finds two poses, one period apart."""
    period = pose("a", "a", (6.0, 0.0, 0.0))
    pairs = [_symmetric(period), registered(_OTHER)]
    if confirmed:
        pairs += [registered(pose("a", "d")), registered(pose("d", "c"))]
    after = check_scene_symmetry(pairs, lambda at: scored(at, distinctive), _CONFIG)
    assert (after[1].verdict.outcome == "undecided") is doubted
    if doubted:
        assert "a and b fit at several poses, and one of these puts c 6.00 m" in after[1].verdict.text
