# SPDX-License-Identifier: Apache-2.0
"""A pair that alone joins two groups is doubted by all that these see."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from multilica.config import CalibrationConfig
from multilica.events import VerdictChanged
from multilica.orchestration import lone_pairs
from multilica.results import Reason, Verdict
from tests.unit.acceptance.made_rig import linked, scored, true_pose
from tests.unit.made_pairs import pose

_REPEATS = Verdict("undecided", (Reason("held_by_repetition", 1.0, 4.6, "the scene repeats", scored(pose("a", "d"))),))
_ELSEWHERE = pose("a", "d", (7.0, 0.0, 0.0))


def _searched(target, source, other=True):
    """A pair whose search found another pose that would count by itself."""
    made = linked(target, source)
    further = (scored(_ELSEWHERE, 300),) if other else ()
    return replace(made, registrations=(*made.registrations, *further))


@pytest.fixture
def doubt(monkeypatch):
    """Doubt pairs with a made verdict on groups; returns the undecided pairs, and the groups that were registered."""

    def run(*pairs, verdict=_REPEATS, searched=()):
        asked, seen = [], []

        def register(target, source, hypotheses, _):
            asked.append((target, source))
            start = hypotheses[0].T_target_source
            assert start.distance_to(true_pose(start.target, start.source)) == pytest.approx((0.0, 0.0), abs=1e-9)
            return SimpleNamespace(verdict=verdict)

        def side_of(_, root, joined):
            return lone_pairs.connected(root, joined)

        monkeypatch.setattr(lone_pairs, "register_sides", register)
        monkeypatch.setattr(lone_pairs, "_side_of", side_of)
        registrations = {(pair.target, pair.source): pair for pair in pairs}
        before = {(pair.target, pair.source): pair for pair in searched}
        state = SimpleNamespace(
            registrations=registrations, searched=before, config=CalibrationConfig(), observe=seen.append
        )
        lone_pairs.doubt_lone_pairs(state)
        undecided = [pair for pair in state.registrations.values() if pair.verdict.outcome == "undecided"]
        changed = [each.registration for each in seen if isinstance(each, VerdictChanged)]
        assert changed == [pair for pair in undecided if pair not in pairs]
        return {pair.target + pair.source for pair in undecided}, asked

    return run


_GROUP = [linked("a", "b"), linked("b", "c"), linked("a", "c")]


def test_a_lone_pair_goes_with_those_that_repeat_it(doubt):
    implied = replace(linked("b", "d"), hypothesis=-1)
    undecided, asked = doubt(*_GROUP, implied, _searched("a", "d"))
    assert undecided == {"ad", "bd"}
    assert asked == [({"a", "b", "c"}, {"d"})]


@pytest.mark.parametrize(
    "pairs",
    [
        [*_GROUP, _searched("a", "d", other=False)],
        [*_GROUP, linked("b", "d"), _searched("a", "d")],
        [_searched("a", "d")],
    ],
    ids=["no other pose", "another search confirms it", "two LiDARs"],
)
def test_others_are_not_tested(doubt, pairs):
    assert doubt(*pairs) == (set(), [])


_SLIDES = Verdict("undecided", (Reason("not_observable", 0.2, 0.15, "it slides"),))


@pytest.mark.parametrize("verdict", [Verdict("accept"), _SLIDES], ids=["one pose", "no other pose"])
def test_groups_that_fit_at_no_other_pose_leave_it(doubt, verdict):
    undecided, asked = doubt(*_GROUP, _searched("a", "d"), verdict=verdict)
    assert not undecided
    assert len(asked) == 1


_TWO_PLACES = replace(_searched("b", "c"), verdict=Verdict("undecided"))
_THREE_PLACES = replace(_TWO_PLACES, registrations=(*_TWO_PLACES.registrations, _TWO_PLACES.registrations[1]))


def test_a_lone_pair_needs_more_evidence_where_the_scene_repeats(doubt):
    few = linked("a", "d", 100)
    assert 2.3 < few.evidence < 6.9
    undecided, asked = doubt(_THREE_PLACES, few, linked("a", "b"))
    assert undecided == {"bc", "ad"}
    assert not asked
    assert doubt(_THREE_PLACES, linked("a", "d"), linked("a", "b"))[0] == {"bc"}


def test_three_places_of_a_search_count_after_a_loop(doubt):
    implied = replace(linked("b", "c"), hypothesis=-1)
    pairs = (implied, linked("a", "d", 100), linked("a", "b"))
    assert doubt(*pairs, searched=[_THREE_PLACES])[0] == {"ad"}
    assert not doubt(*pairs, searched=[_TWO_PLACES])[0]


def _in_long_place(made, along=15.0):
    """The pair where few points constrain a shift along x, beside 200 that do across."""
    best = made.registrations[0]
    information = np.diag([50.0, 200.0, 200.0, along, 200.0, 400.0])
    return replace(made, registrations=(replace(best, visibility=replace(best.visibility, information=information)),))


def test_a_lone_pair_needs_more_evidence_in_a_tunnel(doubt):
    few, imprecise = linked("a", "d", 100), linked("a", "d", 100, Verdict("uncertain"))
    assert doubt(_in_long_place(few))[0] == {"ad"}
    for other in (_in_long_place(linked("a", "d")), _in_long_place(few, along=40.0), _in_long_place(imprecise)):
        assert not doubt(other)[0]


def test_a_second_search_confirms_it(doubt):
    pairs = [linked(*names, 100) for names in ("ab", "bd", "ad")]
    assert doubt(_THREE_PLACES, *pairs)[0] == {"bc"}


@pytest.mark.parametrize(
    "other", [_TWO_PLACES, replace(_THREE_PLACES, verdict=Verdict("reject"))], ids=["two poses", "refused"]
)
def test_a_scene_that_does_not_repeat_asks_for_no_more(doubt, other):
    undecided, _ = doubt(other, linked("a", "d", 100))
    assert "ad" not in undecided
