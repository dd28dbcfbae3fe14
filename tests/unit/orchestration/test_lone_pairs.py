# SPDX-License-Identifier: Apache-2.0
"""A pair that alone joins two groups is doubted by all that these see."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from multilica.config import CalibrationConfig
from multilica.events import VerdictChanged
from multilica.orchestration import lone_pairs
from multilica.registration.poses import moved
from multilica.results import Group, Reason, Verdict
from tests.unit.acceptance.made_rig import linked, moved_to, scored, true_pose
from tests.unit.made_pairs import pose, undecided


def _repeats(target, source):
    beside = scored(moved(true_pose(target, source), np.zeros(3), np.array([5.0, 0.0, 0.0])))
    return Verdict("undecided", (Reason("held_by_repetition", 1.0, 4.6, "the scene repeats", beside),))


_REPEATS = _repeats("a", "d")
_ELSEWHERE = pose("a", "d", (7.0, 0.0, 0.0))


def _searched(target, source, other=True):
    """A pair whose search found another pose that would count by itself."""
    made = linked(target, source)
    further = (scored(pose(target, source, (7.0, 0.0, 0.0)), 300),) if other else ()
    return replace(made, registrations=(*made.registrations, *further))


def _state(pairs, searched=(), rough=(), implied_by=None, coarse=(), cut_short=False):
    """Results of the stages; `rough` poses score as well as the best, others have no evidence."""

    def score(at):
        return scored(at, 600 if any(at.distance_to(each)[0] < 1e-6 for each in rough) else 0)

    return SimpleNamespace(
        registrations={(pair.target, pair.source): pair for pair in pairs},
        searched={(pair.target, pair.source): pair for pair in searched},
        verified={(pair.target, pair.source): pair.registrations for pair in searched},
        config=CalibrationConfig(),
        clouds=dict.fromkeys("abcd"),
        coarse=dict.fromkeys(coarse),
        cut_short=cut_short,
        implied_by=implied_by or {},
        score_rough_pose=score,
        side_of=lambda _, poses: {*poses},
    )


@pytest.fixture
def doubt(monkeypatch):
    """Doubt pairs with a made registration of groups; returns the undecided pairs, and what was registered."""

    def run(*pairs, verdict=_REPEATS, at=None, leads=False, **results):
        asked, seen = [], []

        def register(target, source, hypotheses, _):
            start, *further = (each.T_target_source for each in hypotheses)
            assert start.distance_to(true_pose(start.target, start.source)) == pytest.approx((0.0, 0.0), abs=1e-9)
            asked.append((target, source, *(each.xyz_m.tolist() for each in further)))
            return SimpleNamespace(verdict=verdict, T_target_source=at or start, evidence=20.0)

        monkeypatch.setattr(lone_pairs, "register_sides", register)
        monkeypatch.setattr(lone_pairs, "leads_surely", lambda _target, _source, starts, _: leads and bool(starts))
        state = _state(pairs, **results)
        state.observe = seen.append
        lone_pairs.doubt_lone_pairs(state)
        undecided = [pair for pair in state.registrations.values() if pair.verdict.outcome == "undecided"]
        changed = [each.registration for each in seen if isinstance(each, VerdictChanged)]
        assert changed == [pair for pair in undecided if pair not in pairs]
        return {pair.target + pair.source for pair in undecided}, asked

    return run


_GROUP = [linked("a", "b"), linked("b", "c"), linked("a", "c")]


@pytest.mark.parametrize(
    ("coarse", "undecided"),
    [
        ((("a", "b"), ("c", "d")), {"ab"}),
        ((("a", "b"),), {"ab"}),
        ((("a", "b"), ("b", "c")), set()),
        ((("a", "b"), ("a", "d")), set()),
    ],
)
def test_a_lone_pair_counts_when_most_were_compared(doubt, coarse, undecided):
    assert doubt(linked("a", "b"), coarse=coarse, cut_short=True) == (undecided, [])
    assert doubt(linked("a", "b"), coarse=coarse, cut_short=False) == (set(), [])


def test_pairs_that_confirm_each_other_need_no_time(doubt):
    assert doubt(*_GROUP, coarse=[("a", "b")], cut_short=True) == (set(), [])


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


def test_groups_whose_pair_surely_leads_are_not_registered(doubt):
    assert doubt(*_GROUP, _searched("a", "d"), leads=True) == (set(), [])


@pytest.mark.parametrize(("yaw_rad", "undecided"), [(np.pi, {"ab", "bc"}), (0.5, {"ab"})])
def test_a_turn_that_groups_see_doubts_the_next_lone_pair(doubt, yaw_rad, undecided):
    turned = scored(pose("a", "b", (1.0, 2.0, 0.0), yaw_rad))
    twice = Verdict("undecided", (Reason("ambiguous", 1.0, 4.6, "it fits turned", turned),))
    assert doubt(_searched("a", "b"), linked("b", "c"), verdict=twice)[0] == undecided


def test_a_turn_is_known_to_both_lidars_of_a_pair(doubt):
    turned = scored(pose("a", "b", (1.0, 2.0, 0.0), np.pi))
    twice = Verdict("undecided", (Reason("ambiguous", 1.0, 4.6, "it fits turned", turned),))
    assert doubt(_searched("a", "b"), linked("a", "c"), verdict=twice)[0] == {"ab", "ac"}


def test_groups_that_fit_better_elsewhere_are_not_joined(doubt):
    assert doubt(*_GROUP, _searched("a", "d"), verdict=Verdict("accept"), at=_ELSEWHERE)[0] == {"ad"}


def test_what_both_found_to_a_third_lidar_is_tested(doubt):
    """Searches of both LiDARs to a third one imply a pose that their own search missed."""
    shifted = moved_to(replace(linked("c", "d"), verdict=Verdict("undecided")), pose("c", "d", (3.0, 0.0, 0.0)))
    to_third = replace(linked("a", "c"), verdict=Verdict("undecided"))
    implied = true_pose("a", "c") @ shifted.T_target_source
    pairs = linked("a", "d"), to_third, shifted
    undecided, asked = doubt(*pairs, searched=(to_third, shifted), rough=(true_pose("a", "d"), implied))
    assert undecided == {"ad", "ac", "cd"}
    assert asked == [({"a"}, {"d"}, pytest.approx(implied.xyz_m.tolist()))]
    assert doubt(*pairs, searched=(to_third, shifted), rough=(true_pose("a", "d"),)) == ({"ac", "cd"}, [])
    by_chance = replace(to_third, registrations=(scored(true_pose("a", "c"), 5),))
    assert by_chance.evidence < 2.3
    assert not doubt(*pairs, searched=(by_chance, shifted), rough=(true_pose("a", "d"), implied))[1]


def test_what_a_search_between_the_groups_found_is_tested(doubt):
    """One of the LiDARs found the true pose and could not decide; the other one found a wrong pose only."""
    elsewhere = pose("a", "d", (3.0, 0.0, 0.0))
    undecided = moved_to(replace(linked("b", "d"), verdict=Verdict("undecided")), true_pose("b", "a") @ elsewhere)
    pairs = linked("a", "b"), linked("a", "d"), undecided
    rough = true_pose("a", "b"), true_pose("a", "d")
    found, asked = doubt(*pairs, searched=(undecided,), rough=(*rough, elsewhere))
    assert found == {"ad", "bd"}
    assert asked == [({"a", "b"}, {"d"}, pytest.approx(elsewhere.xyz_m.tolist()))]
    assert not doubt(*pairs, searched=(undecided,), rough=rough)[1]


def test_pairs_beside_an_open_repetition_are_tested(doubt):
    """Two pairs agree on a house, and a third search between their groups found the next one as well."""
    pairs = linked("a", "b"), linked("b", "c"), linked("a", "d"), linked("b", "d")
    open_one = replace(_searched("c", "d"), verdict=_REPEATS)
    elsewhere = [true_pose(name, "c") @ open_one.registrations[1].T_target_source for name in "ab"]
    rough = *(true_pose(*names) for names in ("ab", "bc", "ad", "bd")), *elsewhere
    undecided, asked = doubt(*pairs, searched=(open_one,), rough=rough, verdict=_repeats("b", "d"))
    assert undecided == {"ad", "bd"}
    ((target, source, *further),) = asked
    assert (target, source) == ({"a", "b", "c"}, {"d"})
    assert len(further) == 1
    found = replace(open_one, verdict=Verdict("undecided"))
    assert doubt(*pairs, searched=(found,), rough=rough) == (set(), [])


def test_two_lidars_are_not_tested_at_what_their_search_found(doubt):
    assert not doubt(linked("a", "d"), searched=(_searched("a", "d"),), rough=(true_pose("a", "d"), _ELSEWHERE))[1]


def test_pairs_that_a_doubted_one_implied_go_with_it(doubt):
    """Their ends are linked by nothing else, so that no group tells that they repeat it."""
    implied = replace(linked("b", "c"), hypothesis=-1)
    through = {("b", "c"): [frozenset("ab"), frozenset("ad"), frozenset("cd")]}
    pairs = linked("a", "b"), _searched("a", "d"), implied
    assert doubt(*pairs, implied_by=through)[0] == {"ad", "bc"}
    assert doubt(*pairs, implied_by={("b", "c"): [frozenset("ab")]})[0] == {"ad"}


_TWO_PLACES = replace(_searched("b", "c"), verdict=Verdict("undecided"))


def test_a_lone_pair_needs_more_evidence_where_the_scene_repeats(doubt):
    few = linked("a", "d", 100)
    assert 2.3 < few.evidence < 6.9
    undecided, asked = doubt(_TWO_PLACES, few, linked("a", "b"))
    assert undecided == {"bc", "ad"}
    assert not asked
    assert doubt(_TWO_PLACES, linked("a", "d"), linked("a", "b"))[0] == {"bc"}


def test_places_of_a_search_count_after_a_loop(doubt):
    implied = replace(linked("b", "c"), hypothesis=-1)
    pairs = (implied, linked("a", "d", 100), linked("a", "b"))
    assert doubt(*pairs, searched=[_TWO_PLACES])[0] == {"ad"}
    assert not doubt(*pairs, searched=[linked("b", "c")])[0]


@pytest.mark.parametrize(("distinctive", "doubted"), [(30, {"ad", "bd"}), (200, set())])
def test_pairs_that_join_two_groups_count_together(doubt, distinctive, doubted):
    """Two LiDARs side by side that take one house for the next agree."""
    weak = [linked("a", "d", distinctive), linked("b", "d", distinctive)]
    assert all(pair.evidence < 6.9 for pair in weak)
    assert (sum(pair.evidence for pair in weak) < 6.9) == bool(doubted)
    assert doubt(_searched("a", "b"), *weak) == (doubted, [])


def _in_long_place(made, along=15.0):
    """The pair where few points constrain a shift along x, beside 200 that do across."""
    best = made.registrations[0]
    information = np.diag([50.0, 200.0, 200.0, along, 200.0, 400.0])
    return replace(made, registrations=(replace(best, visibility=replace(best.visibility, information=information)),))


def test_a_lone_pair_needs_more_evidence_in_a_tunnel(doubt):
    few, imprecise = linked("a", "d", 100), linked("a", "d", 100, Verdict("uncertain"))
    some = linked("a", "d", 300)
    assert few.evidence < 5.0 < some.evidence < 6.9
    assert doubt(_in_long_place(few))[0] == doubt(_in_long_place(imprecise))[0] == {"ad"}
    for other in (_in_long_place(some), _in_long_place(few, along=40.0)):
        assert not doubt(other)[0]


_APART = Group.of_one("a"), Group.of_one("d")


@pytest.mark.parametrize("distinctive", [100, 600])
@pytest.mark.parametrize("between", [[], [linked("a", "d", 100)]], ids=["no pair", "a pair"])
def test_groups_without_a_pair_need_as_much(distinctive, between):
    merge = linked("a", "d", distinctive)
    found = lone_pairs.doubt_merge(_state([_TWO_PLACES]), merge, _APART, between)
    assert found.verdict.codes == (("held_by_repetition",) if distinctive == 100 and not between else ())
    assert lone_pairs.doubt_merge(_state([]), merge, _APART, between) is merge


@pytest.mark.parametrize(("code", "doubted"), [("ambiguous", True), ("not_observable", False)])
def test_groups_with_an_ambiguous_pair_need_a_margin_more(code, doubted):
    """Another pose is possible for two of their LiDARs, and either may fit by chance."""
    between = [linked("a", "d", 100, undecided(code))]
    merge, clear = linked("a", "d", 600), linked("a", "d", 6000)
    found = lone_pairs.doubt_merge(_state([]), merge, _APART, between)
    assert found.verdict.codes == (("held_by_repetition",) if doubted else ())
    assert lone_pairs.doubt_merge(_state([]), clear, _APART, between) is clear


@pytest.mark.parametrize(
    ("distinctive", "elsewhere", "code", "doubted"),
    [
        (2000, True, "cycle_contradicted", True),
        (300, True, "cycle_contradicted", False),
        (2000, False, "cycle_contradicted", False),
        (2000, True, "not_observable", False),
    ],
    ids=["stronger", "weaker", "same pose", "not contradicted"],
)
def test_a_stronger_contradicted_pair_speaks_against_a_merge(distinctive, elsewhere, code, doubted):
    """The pair is between other members of the groups than the roots, and the other way round."""
    groups = Group("a", {name: true_pose("a", name) for name in "ab"}), Group.of_one("d")
    made = linked("d", "b", distinctive, undecided(code))
    against = moved_to(made, made.T_target_source @ pose("b", "b", (7.0, 0.0, 0.0))) if elsewhere else made
    merge = linked("a", "d", 600)
    found = lone_pairs.doubt_merge(_state([]), merge, groups, [against])
    assert found.verdict.codes == (("ambiguous",) if doubted else ())


def test_a_scene_that_does_not_repeat_asks_for_no_more(doubt):
    refused = replace(linked("b", "c"), verdict=Verdict("reject"))
    undecided, _ = doubt(refused, linked("a", "d", 100))
    assert not undecided
