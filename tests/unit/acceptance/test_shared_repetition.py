# SPDX-License-Identifier: Apache-2.0
"""Pairs with another pose that an undecided pair of the same, repeating scene found."""

import pytest

from multilica.acceptance.rig import check_shared_repetition
from multilica.config import AcceptanceConfig
from tests.unit.acceptance.made_rig import linked, registered, scored, true_pose
from tests.unit.made_pairs import pose, undecided

_CONFIG = AcceptanceConfig()
_BAYS_M = 7.5


def _bays_away(target, source, bays_m=_BAYS_M):
    """Return the pose at which the source stands some bays farther along the target's x."""
    return pose(target, target, (bays_m, 0.0, 0.0)) @ true_pose(target, source)


def _repeats(target="a", source="c"):
    """Make an undecided pair that finds its true pose and one some bays away."""
    return registered(true_pose(target, source), 600, undecided("ambiguous"), competing=(_bays_away(target, source),))


def _wrong(target="b", source="c", bays_m=_BAYS_M):
    """Make an accepted pair that found only the pose some bays away."""
    at = true_pose(target, "a") @ _bays_away("a", source, bays_m)
    return registered(at)


_LINK = linked("a", "b")


def _score(at, distinctive=600, violate=0):
    """Score all poses alike, but for those of a and b: these two do not stand in a row."""
    apart_m = at.distance_to(true_pose(at.target, at.source))[0]
    return scored(at, distinctive, 400 if {at.target, at.source} == {"a", "b"} and apart_m > 1.0 else violate)


def test_a_pose_that_another_pair_finds_as_well_is_possible():
    after = check_shared_repetition([_LINK, _wrong(), _repeats()], _score, _CONFIG)
    assert [each.verdict.outcome for each in after] == ["accept", "undecided", "undecided"]
    (reason,) = after[1].verdict.reasons
    assert reason.code == "ambiguous"
    assert reason.competing.T_target_source.distance_to(true_pose("b", "c"))[0] < 1e-9
    assert "a and c fit at several poses, and one of these puts c 7.50 m and 0 deg away" in after[1].verdict.text


@pytest.mark.parametrize("turned", [False, True])
def test_the_order_of_the_lidars_does_not_matter(turned):
    known = _repeats("c", "a") if turned else _repeats()
    wrong = registered(_wrong().T_target_source.inverse()) if turned else _wrong()
    known_bays = registered(
        _bays_away("a", "c").inverse(), 600, undecided("ambiguous"), competing=(true_pose("c", "a"),)
    )
    after = check_shared_repetition([_LINK, wrong, known_bays if turned else known], _score, _CONFIG)
    assert after[1].verdict.outcome == "undecided"


def test_beams_against_the_other_pose_keep_the_pair():
    def against(at):
        away_m = at.distance_to(_wrong().T_target_source)[0] if {at.target, at.source} == {"b", "c"} else 0.0
        return _score(at, violate=400 if away_m > 1.0 else 0)

    pairs = [_LINK, _wrong(), _repeats()]
    after = check_shared_repetition(pairs, against, _CONFIG)
    assert all(one is other for one, other in zip(after, pairs, strict=True))


def test_a_pair_that_a_cycle_confirms_is_kept():
    pairs = [_LINK, _wrong(), linked("b", "d"), registered(true_pose("d", "b") @ _wrong().T_target_source), _repeats()]
    after = check_shared_repetition(pairs, _score, _CONFIG)
    assert [each.verdict.outcome for each in after[:4]] == ["accept"] * 4


def test_a_pose_beyond_the_largest_baseline_is_none():
    known = registered(true_pose("a", "c"), 600, undecided("ambiguous"), competing=(_bays_away("a", "c", 16.0),))
    after = check_shared_repetition([_LINK, linked("b", "c"), known], _score, _CONFIG)
    assert after[1].verdict.outcome == "accept"


def test_the_undecided_pair_decides_between_its_poses_too():
    known = _repeats()

    def for_the_wrong(at):
        near = at.distance_to(true_pose("a", "c"))[0] < 1.0 if (at.target, at.source) == ("a", "c") else False
        return _score(at, 0 if near else 600)

    assert check_shared_repetition([_LINK, _wrong(), known], for_the_wrong, _CONFIG)[1].verdict.outcome == "accept"
