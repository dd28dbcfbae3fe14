# SPDX-License-Identifier: Apache-2.0
"""Poses of the same attitude: what faces the way between them, and what repeats."""

from dataclasses import replace

import numpy as np
import pytest

from multilica.acceptance.accept import accept, competing_poses, likeliest_first, may_compete
from multilica.config import AcceptanceConfig
from tests.unit.acceptance.made_registrations import ELSEWHERE, registration
from tests.unit.made_pairs import pose

_CONFIG = AcceptanceConfig()


def _accept(*registrations):
    return accept(registrations, _CONFIG)


def _facing(at, facing, distinctive):
    """Make a registration with so many points that face the x axis and agree nowhere else."""
    found = registration(at, distinctive=distinctive)
    score = replace(
        found.visibility,
        violating=np.zeros(100, dtype=bool),
        agreeing=np.arange(facing, dtype=np.int32),
        agreeing_normals=np.tile(np.float16([1.0, 0.0, 0.0]), (facing, 1)),
    )
    return replace(found, visibility=score)


def test_the_pose_that_leads_all_others_is_the_first():
    slid = [_facing(pose("t", "s", (x_m, 0.0, 0.0)), 1, count) for x_m, count in ((4.0, 900), (5.0, 850), (6.0, 800))]
    true = _facing(pose("t", "s", (7.0, 0.0, 0.0)), 50, 700)
    for found in ([*slid, true], [true, *slid], [slid[2], true, slid[0], slid[1]]):
        assert likeliest_first(found) == [true, *slid]
    assert likeliest_first(slid[::-1]) == slid
    assert likeliest_first([]) == []


def test_a_pose_that_leads_by_facing_points_is_accepted():
    slid, true = _facing(pose("t", "s", (8.0, 0.0, 0.0)), 1, 900), _facing(pose("t", "s", (5.0, 0.0, 0.0)), 80, 700)
    assert _accept(*likeliest_first([slid, true])).accepted
    few = _facing(pose("t", "s", (5.0, 0.0, 0.0)), 6, 600)
    assert _accept(*likeliest_first([slid, few])).outcome == "undecided"


def test_facing_points_do_not_outweigh_more_evidence():
    slid, true = _facing(pose("t", "s", (6.5, 0.0, 0.0)), 1, 900), _facing(pose("t", "s", (7.5, 0.0, 0.0)), 80, 700)
    assert true.lead_over(slid) > _CONFIG.min_log_odds_margin
    (reason,) = _accept(*likeliest_first([slid, true])).reasons
    assert (reason.code, reason.competing) == ("ambiguous", slid)
    assert (reason.value, reason.limit) == (true.evidence - slid.evidence, 0.0)
    assert "a pose 1.00 m away has more evidence (" in reason.text


_BESIDE = pose("t", "s", (5.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("beside", "changed", "outcome"),
    [
        (_BESIDE, {}, "undecided"),
        (pose("t", "s", (6.5, 0.0, 0.0)), {}, "accept"),
        (ELSEWHERE, {}, "accept"),
        (_BESIDE, {"distinctive": 50}, "accept"),
        (_BESIDE, {"violate": 13, "distinctive": 3000}, "accept"),
    ],
    ids=["same attitude", "beyond a vehicle", "turned", "too little evidence", "contradicted"],
)
def test_a_pose_one_period_on_leaves_it_undecided(beside, changed, outcome):
    """Where surfaces repeat, both LiDARs at one place have the largest common view."""
    best, other = registration(distinctive=4000), registration(beside, **{"distinctive": 300, **changed})
    assert best.lead_over(other) > _CONFIG.min_log_odds_margin
    assert (other.evidence > _CONFIG.min_evidence) == (changed != {"distinctive": 50})
    assert may_compete(best, other, _CONFIG) or outcome == "accept"
    verdict = _accept(best, other)
    assert verdict.outcome == outcome
    if outcome == "undecided":
        (reason,) = verdict.reasons
        assert (reason.code, reason.competing) == ("held_by_repetition", other)
        assert (reason.value, reason.limit) == (other.evidence, _CONFIG.min_evidence)
        assert "a pose 5.00 m away is possible too (evidence" in reason.text


def test_between_stops_other_links_tell_what_repeats():
    pair = [registration(distinctive=4000), registration(_BESIDE, distinctive=300)]
    assert not _accept(*pair).accepted
    stops = [replace(each, visibility=replace(each.visibility, between_stops=True)) for each in pair]
    assert competing_poses(stops, _CONFIG) == []
