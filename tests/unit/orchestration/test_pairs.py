# SPDX-License-Identifier: Apache-2.0
"""All stages of a pair in one task, as far as they are asked for."""

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from multilica import time_limit
from multilica.config import CalibrationConfig, with_overrides
from multilica.geometry import RigidTransform
from multilica.orchestration import pairs
from multilica.orchestration.pairs import (
    PAIR_STAGES,
    SearchRequest,
    better_along_slide,
    lead_over_shifts,
    prepare_lidar,
    register_implied,
    register_roughly_implied,
    score_implied,
    search_pair,
)
from multilica.registration.poses import moved
from multilica.results import PRIOR, Hypothesis, Verdict
from tests.unit.made_rooms import HALL, Face, box, scan

_CONFIG = CalibrationConfig()
_TARGET = RigidTransform.from_xyz_rpy("world", "t", [-1.0, 0.0, 1.8], [0.03, 0.1, 0.4])
_SOURCE = RigidTransform.from_xyz_rpy("world", "s", [1.0, 0.8, 1.6], [-0.1, 0.2, -1.2])
_TRUTH = _TARGET.inverse() @ _SOURCE
_USUAL_M = _CONFIG.features.voxel_size_m


def _prepared(config=_CONFIG):
    clouds = scan("t", _TARGET, HALL), scan("s", _SOURCE, HALL, seed=1)
    return {cloud.lidar: prepare_lidar(cloud, config) for cloud in clouds}


@pytest.fixture(scope="module")
def lidars():
    return _prepared()


def _search(lidars, until="fine", **request):
    return search_pair(lidars, SearchRequest(("t", "s"), _USUAL_M, until=until, **request))


@pytest.mark.parametrize("until", PAIR_STAGES)
def test_a_search_goes_as_far_as_asked(lidars, until):
    found = _search(lidars, until)
    results = (found.matches, found.coarse, found.verified, found.registration)
    done = PAIR_STAGES.index(until) + 1
    assert [result is not None for result in results] == [index < done for index in range(4)]
    assert list(found.elapsed_s) == list(PAIR_STAGES[:done])
    assert all(elapsed_s >= 0.0 for elapsed_s in found.elapsed_s.values())


def test_a_search_ends_at_its_deadline(lidars, monkeypatch):
    now = time.monotonic()
    assert _search(lidars, deadline_s=now) is None
    assert _search(lidars, deadline_s=now + 600.0).registration is not None
    asked = iter(range(10_000))
    monkeypatch.setattr(time_limit, "time", SimpleNamespace(monotonic=lambda: float(next(asked))))
    assert _search(lidars, deadline_s=1.5) is None
    assert next(asked) == 3  # before the search and two registrations
    time_limit.require_time()  # no request is left: the clock is not asked
    assert next(asked) == 4


def test_a_pose_that_too_few_surfaces_hold_is_not_accepted():
    sparse = _prepared(with_overrides(_CONFIG, ["fine.max_points=30"]))
    found = register_implied(sparse, Hypothesis(_TRUTH))
    assert found.evidence > _CONFIG.acceptance.min_evidence
    assert (found.information, found.verdict.outcome, found.verdict.codes) == (None, "undecided", ("sigma_unknown",))
    assert found.verdict.text == "too few surfaces match to tell its sigma"


def test_a_search_finds_the_pose_of_a_pair(lidars):
    found = _search(lidars).registration
    metres, radians = found.T_target_source.with_target("t").distance_to(_TRUTH)
    assert metres < 0.01
    assert radians < np.deg2rad(0.1)
    assert found.verdict.accepted


def test_a_prior_is_one_more_hypothesis(lidars):
    plain, known = (_search(lidars, "coarse", prior=prior).coarse.hypotheses for prior in (None, _TRUTH))
    assert len(known) == len(plain) + 1
    assert known[-1].origin == PRIOR
    assert known[-1].T_target_source is _TRUTH


def test_without_verification_the_fitness_decides():
    unverified = _prepared(with_overrides(_CONFIG, ["verify.enabled=false"]))
    found = _search(unverified)
    assert found.verified is None
    assert "verify" not in found.elapsed_s
    assert found.registration.registrations == ()
    assert found.registration.verdict.accepted is (found.registration.fitness >= 0.2)


def test_without_a_hypothesis_there_is_no_registration():
    far = _prepared(with_overrides(_CONFIG, ["acceptance.max_baseline_m=0.001"]))
    found = _search(far)
    assert found.coarse.hypotheses == ()
    assert found.verified == ()
    assert found.registration is None


def test_a_search_again_ends_where_nothing_can_be_accepted(lidars, monkeypatch):
    assert _search(lidars, refused=()).registration.verdict.accepted
    monkeypatch.setattr(pairs, "may_be_accepted", lambda *_: False)
    assert _search(lidars, refused=()).registration is None
    assert _search(lidars).registration is not None


def _asked_for_poses_beside(monkeypatch):
    """Return the calls for poses beside a registered one; a made one, as likely as the pose itself, is found."""
    asked = []

    def found_far(_target, _source, registered, _config, *, led):
        asked.append((registered, led))
        (best, *_) = registered.registrations
        frame = best.T_target_source.target
        far = RigidTransform.from_xyz_rpy(frame, frame, (9, 0, 0), (0, 0, 0))
        return [replace(best, T_target_source=far @ best.T_target_source)]

    monkeypatch.setattr(pairs, "find_poses_beside", found_far)
    return asked


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_link_that_counts_is_registered_beside_far_ones(lidars, monkeypatch):
    """A made one, as likely as the pose itself, makes that undecided."""
    asked = _asked_for_poses_beside(monkeypatch)
    assert _search(lidars).registration.verdict.accepted
    assert asked == []
    lidars = {name: lidar.with_view(replace(lidar.view, at_stop=True)) for name, lidar in lidars.items()}
    with monkeypatch.context() as none_found:
        none_found.setattr(pairs, "find_poses_beside", lambda *_, **__: [])
        plain = _search(lidars)
    registered = []
    monkeypatch.setattr(pairs, "register_sides", _recording(pairs.register_sides, registered))
    found = _search(lidars)
    assert [(each.target, led) for each, led in asked] == [(plain.registration.target, True)]
    starts = [[each.T_target_source.target for each in hypotheses] for hypotheses in registered]
    assert starts[-1] == ["t", "t"]
    assert len(found.verified) == len(plain.verified) + 1
    monkeypatch.setattr(pairs, "accept", lambda *_: Verdict("undecided"))
    assert _search(lidars).registration.verdict.outcome == "undecided"
    assert len(asked) == 1


@pytest.mark.slow
def test_poses_known_before_count_beside_those_found_later(lidars, monkeypatch):
    lidars = {name: lidar.with_view(replace(lidar.view, at_stop=True)) for name, lidar in lidars.items()}
    monkeypatch.setattr(pairs, "find_poses_beside", lambda *_, **__: [])
    search = _search(lidars)
    (best, *_) = search.registration.registrations
    assert search.registration.verdict.accepted
    frame = best.T_target_source.target
    away, astray = (RigidTransform.from_xyz_rpy(frame, frame, (x_m, 0, 0), (0, 0, 0)) for x_m in (6.0, -200.0))
    rival = replace(best, T_target_source=away @ best.T_target_source)
    hopeless = replace(best, T_target_source=astray @ best.T_target_source)
    search.registration = replace(search.registration, registrations=(best, rival))
    monkeypatch.setattr(pairs, "find_poses_beside", lambda *_, **__: [hopeless])
    pairs._beside_further_poses(search, lidars["t"], lidars["s"])
    assert rival in search.registration.registrations
    assert search.registration.verdict.outcome == "undecided"


def test_a_pose_that_did_not_lead_is_registered_beside_its_own(lidars, monkeypatch):
    """The verification preferred a pose 20 m away; the registered one was not tested beside its own."""
    asked = _asked_for_poses_beside(monkeypatch)
    verify = pairs.verify_hypotheses

    def preferring_another(*arguments):
        (best, *others) = verify(*arguments)
        frame = best.T_target_source.target
        far = RigidTransform.from_xyz_rpy(frame, frame, (0, 20, 0), (0, 0, 0))
        return (replace(best, T_target_source=far @ best.T_target_source), best, *others)

    monkeypatch.setattr(pairs, "verify_hypotheses", preferring_another)
    found = _search(lidars)
    assert [led for _, led in asked] == [False]
    assert len(found.registration.registrations) == 2


def test_a_winner_among_competitors_is_registered_beside_its_own(lidars, monkeypatch):
    """The verification stopped at a competitor, so that poses farther along a slide were not tested."""
    asked = _asked_for_poses_beside(monkeypatch)
    monkeypatch.setattr(pairs, "is_surely_ambiguous", lambda verified, _config: bool(verified))
    assert len(_search(lidars).registration.registrations) == 2
    assert [led for _, led in asked] == [False]


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_pair_with_many_competitors_is_told_by_some_of_them(lidars, monkeypatch):
    """If these do not leave it undecided, all its poses are registered."""
    registered = []
    monkeypatch.setattr(pairs, "register_sides", _recording(pairs.register_sides, registered))
    monkeypatch.setattr(pairs, "_beside_further_poses", lambda *_: None)
    plain = _search(lidars)
    assert len(registered) == 1
    best = plain.verified[0]
    frame = best.T_target_source.target
    slid = [RigidTransform.from_xyz_rpy(frame, frame, (1.0 * n, 0, 0), (0, 0, 0)) for n in range(1, 8)]
    alike = (best, *(replace(best, T_target_source=each @ best.T_target_source) for each in slid))
    monkeypatch.setattr(pairs, "verify_hypotheses", lambda *_: alike)
    monkeypatch.setattr(pairs, "accept", lambda *_: Verdict("undecided"))
    _search(lidars)
    assert len(registered[-1]) == 5
    monkeypatch.setattr(pairs, "accept", lambda *_: Verdict("reject"))
    _search(lidars)
    assert [len(each) for each in registered[-2:]] == [5, 8]


def _recording(register, registered):
    def one(target, source, hypotheses, config, **options):
        registered.append(hypotheses)
        return register(target, source, hypotheses, config, **options)

    return one


def test_an_implied_pose_is_scored_and_registered_from_there(lidars):
    near = RigidTransform.from_xyz_rpy("t", "t", (0.05, 0.0, 0.0), (0.0, 0.0, 0.01)) @ _TRUTH
    scored, registered = score_implied(lidars, near), register_implied(lidars, Hypothesis(near))
    assert scored.T_target_source is near
    assert np.isnan(scored.fitness)
    assert registered.T_target_source.with_target("t").distance_to(_TRUTH)[0] < 0.01
    assert registered.hypothesis == -1
    assert registered.evidence > scored.evidence


@pytest.mark.parametrize(
    ("off_m", "register", "by_gicp"),
    [
        (0.01, register_implied, False),
        (0.05, register_implied, True),
        (0.01, register_roughly_implied, True),
    ],
)
def test_gicp_is_left_out_where_an_implied_pose_fits(lidars, off_m, register, by_gicp):
    near = moved(_TRUTH, np.zeros(3), np.array([off_m, 0.0, 0.0]))
    registered = register(lidars, Hypothesis(near))
    assert bool(registered.steps) == by_gicp
    assert registered.T_target_source.with_target("t").distance_to(_TRUTH)[0] < 0.01


def _sliding(lidars, pose, along):
    lead_over = score_implied(lidars, pose).lead_over
    return SimpleNamespace(T_target_source=pose, visibility=SimpleNamespace(slide_direction=along), lead_over=lead_over)


def test_a_place_that_leads_back_is_not_better(lidars, monkeypatch):
    """A place that seems better is registered first, because poses some decimetres off compare roughly."""
    along = np.array([0.6, 0.8, 0.0])
    found = _sliding(lidars, moved(_TRUTH, np.zeros(3), 2.6 * along), along)
    back = register_implied(lidars, Hypothesis(_TRUTH)).registrations[0]
    pose = replace(back, T_target_source=found.T_target_source)
    monkeypatch.setattr(pairs, "register_roughly_implied", lambda *_: SimpleNamespace(registrations=(pose,)))
    assert better_along_slide(lidars, found) is None


def test_a_place_along_the_slide_may_fit_better(lidars):
    along, off_m = np.array([0.6, 0.8, 0.0]), 2.6
    lead, away_m = better_along_slide(lidars, _sliding(lidars, moved(_TRUTH, np.zeros(3), off_m * along), along))
    assert lead < 0.0
    assert away_m == pytest.approx(off_m, abs=0.1)
    assert better_along_slide(lidars, _sliding(lidars, _TRUTH, along)) is None


_PERIOD_M = 6.0
_ROW = [
    Face(2, 0.0, (-60.0, -20.0, 0.0), (60.0, 20.0, 0.0)),
    *(face for x_m in np.arange(-36.0, 37.0, _PERIOD_M) for face in box((x_m, 5.0, 0.0), (x_m + 2.0, 8.0, 3.0))),
]
_KIOSK = box((2.5, -6.0, 0.0), (5.0, -4.0, 2.5))


@pytest.mark.parametrize(("objects", "is_unique"), [(_ROW, False), ([*_ROW, *_KIOSK], True)], ids=["alone", "kiosk"])
def test_a_row_of_equal_things_fits_after_a_shift(objects, is_unique):
    """What stands at one place only tells the poses apart."""
    clouds = scan("t", _TARGET, objects), scan("s", _SOURCE, objects, seed=1)
    lidars = {cloud.lidar: prepare_lidar(cloud, _CONFIG) for cloud in clouds}
    lead = lead_over_shifts(lidars, SimpleNamespace(T_target_source=_TRUTH))
    assert (lead >= _CONFIG.acceptance.min_log_odds_margin) == is_unique


def test_without_another_place_nothing_competes(lidars):
    assert lead_over_shifts(lidars, SimpleNamespace(T_target_source=_TRUTH)) > 10.0
