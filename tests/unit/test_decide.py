# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from multilica import testimony
from multilica.config import MergeConfig, VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import Assessment, Hold, PairRegistration
from multilica.stages.decide import decide, decide_by_fitness

_CONFIG = VerifyConfig()
_POSE = RigidTransform.identity("t", "s")
_HELD = Hold(sigma_m=0.005, sigma_rad=1e-4, push_m=0.3, pushed_off_m=0.001, thinned_off_m=0.01)
_ELSEWHERE = RigidTransform.from_xyz_rpy("t", "s", [3.0, 4.0, 0.0], [0.0, 0.0, np.pi / 2])


def _answer(pose=_POSE, *, agree=1000, violate=0, plane=400.0, held_by=50.0, curvature=5.0, structure=(0, 0, 0)):
    """`plane` of the agreeing points lie on surfaces of one orientation; `held_by` hold the weakest direction.

    `structure` agrees, violates, is occluded.
    """
    rest = plane / 2.0
    information = np.diag([held_by, rest, rest, rest, rest, plane])
    said = testimony.Testimony(agree, violate, 0, 0, information, np.zeros(0, dtype=np.uint8), *structure)
    return Assessment(0, pose, said, 0.8, 0.03, curvature, np.zeros((0, 3)))


def _codes(verdict):
    return [reason.code for reason in verdict.reasons]


def test_a_clear_answer_is_accepted_without_reasons():
    verdict = decide([_answer(), _answer(_ELSEWHERE, agree=500)], _CONFIG)
    assert verdict.outcome == "accept"
    assert verdict.accepted
    assert verdict.reasons == ()


def test_too_little_overlap_is_rejected():
    verdict = decide([_answer(agree=99, plane=20.0)], _CONFIG)
    assert verdict.outcome == "reject"
    assert _codes(verdict) == ["too_little_overlap"]
    reason = verdict.reasons[0]
    assert (reason.value, reason.limit) == (99, 100)
    assert "only 99 points" in reason.text
    assert "expected 100" in reason.text


def test_points_in_proven_empty_space_are_rejected_however_much_agrees():
    verdict = decide([_answer(agree=9800, violate=200)], _CONFIG)
    assert verdict.outcome == "reject"
    assert _codes(verdict) == ["empty_space_violated"]
    assert verdict.reasons[0].value == pytest.approx(0.02)
    assert verdict.reasons[0].limit == _CONFIG.max_violation_share_firm
    assert "2.0% of the points" in verdict.reasons[0].text
    assert "0.4%" in verdict.reasons[0].text


def test_a_loosely_held_pose_may_violate_less():
    answer = {"agree": 9970, "violate": 30, "structure": (980, 0, 0)}
    loose, firm = (decide([_answer(held_by=held_by, **answer)], _CONFIG) for held_by in (7.9, 8.0))
    assert _codes(loose) == ["empty_space_violated"]
    assert loose.reasons[0].limit == _CONFIG.max_violation_share
    assert firm.accepted


def test_two_points_in_empty_space_are_chance_however_few_agree():
    few, more = (decide([_answer(agree=300, plane=50.0, violate=violate)], _CONFIG) for violate in (2, 3))
    assert few.accepted
    assert _codes(more) == ["empty_space_violated"]


def test_a_lidar_cannot_be_where_beams_pass_through():
    answer = _answer()
    floating = replace(answer, testimony=replace(answer.testimony, seen_through_m=6.2))
    verdict = decide([floating], _CONFIG)
    assert verdict.outcome == "reject"
    assert _codes(verdict) == ["place_proven_empty", "too_little_evidence"]
    assert "6.2 m away" in verdict.reasons[0].text


def test_agreement_on_one_plane_only_is_no_evidence():
    verdict = decide([_answer(agree=1000, plane=975.0)], _CONFIG)
    assert verdict.outcome == "reject"
    assert _codes(verdict) == ["too_little_evidence"]
    assert verdict.reasons[0].value == pytest.approx(25.0)
    assert "25 distinctive points" in verdict.reasons[0].text
    assert "expected 30" in verdict.reasons[0].text


def test_another_answer_that_explains_nearly_as_much_leaves_it_undecided():
    verdict = decide([_answer(agree=1000), _answer(_ELSEWHERE, agree=880, curvature=0.1)], _CONFIG)
    assert verdict.outcome == "undecided"
    assert not verdict.accepted
    assert _codes(verdict) == ["ambiguous"]
    assert verdict.reasons[0].value == pytest.approx(0.8)
    for figure in ("5.00 m and 90 deg", "80%", "70%"):
        assert figure in verdict.reasons[0].text


def test_a_pose_that_would_be_accepted_by_itself_is_a_rival_however_little_it_has_in_view():
    rival = {"agree": 700, "plane": 400.0, "structure": (90, 0, 0)}
    best = _answer(agree=1400, structure=(400, 0, 0))
    verdict = decide([best, _answer(_ELSEWHERE, **rival)], _CONFIG)
    assert _codes(verdict) == ["ambiguous"]
    assert verdict.reasons[0].value == pytest.approx(0.3)
    assert verdict.reasons[0].limit == _CONFIG.max_equal
    for weakness in ({"agree": 149, "plane": 0.0}, {"held_by": 0.05}, {"curvature": 0.1}, {"structure": (90, 0, 50)}):
        assert decide([best, _answer(_ELSEWHERE, **{**rival, **weakness})], _CONFIG).accepted


@pytest.mark.parametrize("flaw", [{"curvature": 0.1}, {"violate": 6}, {"structure": (10, 5, 0)}])
def test_chance_agreement_farther_off_than_a_car_is_long_is_no_rival(flaw):
    def far(distance_m, **said):
        pose = RigidTransform.from_xyz_rpy("t", "s", (distance_m, 0.0, 0.0), (0, 0, 1.0))
        return _answer(pose, **{"agree": 1100, "held_by": 5.0, **said})

    best = _answer(agree=1100)
    assert decide([best, far(6.0, **flaw)], _CONFIG).accepted
    for rival in (far(6.0), far(4.0, **flaw), far(6.0, **{**flaw, "held_by": 50.0})):
        assert _codes(decide([best, rival], _CONFIG)) == ["ambiguous"]


def test_a_rival_along_the_weakest_direction_is_told_as_sliding():
    weakest_x = np.diag([300.0, 300.0, 300.0, 50.0, 300.0, 400.0])
    best = _answer()
    best = replace(best, testimony=replace(best.testimony, information=weakest_x))
    slid, beside = (RigidTransform.from_xyz_rpy("t", "s", xyz_m, (0, 0, 0)) for xyz_m in ((2, 0.1, 0), (0.1, 2, 0)))
    along, across = (decide([best, _answer(pose, agree=990)], _CONFIG) for pose in (slid, beside))
    assert (_codes(along), _codes(across)) == (["not_observable"], ["ambiguous"])
    assert "slide along x of t: 2.00 m away" in along.reasons[0].text
    flat = replace(best, weakest_curvature=0.1)
    assert _codes(decide([flat, _answer(slid, agree=990)], _CONFIG)) == ["not_observable"]


@pytest.mark.parametrize(
    ("weak", "value", "limit", "figures"),
    [
        ({"curvature": 0.1}, 0.1, _CONFIG.min_curvature, "curvature 0.10; expected 0.2"),
        ({"pushed_off_m": 0.26}, 0.26, _CONFIG.max_pushed_off_m, "pushed by 0.3 m, the registration ends 0.260 m away"),
        ({"thinned_off_m": 0.75}, 0.75, _CONFIG.max_thinned_off_m, "with fewer points, the registration ends 0.75 m"),
        ({"sigma_m": 0.03}, 0.03, _CONFIG.max_sigma_m, "standard deviation is 0.030 m; expected 0.02 m"),
        ({"sigma_rad": 0.01}, np.rad2deg(0.01), _CONFIG.max_sigma_deg, "standard deviation is 0.57 deg; expected 0.2"),
        ({"curvature": 0.1, "pushed_off_m": 0.26}, 0.1, _CONFIG.min_curvature, "curvature 0.10"),
    ],
)
def test_a_pose_that_can_slide_leaves_it_undecided(weak, value, limit, figures):
    held = {name: figure for name, figure in weak.items() if name != "curvature"}
    answer = _answer(curvature=weak.get("curvature", 5.0))
    verdict = decide([replace(answer, hold=replace(_HELD, **held))], _CONFIG)
    assert verdict.outcome == "undecided"
    assert _codes(verdict) == ["not_observable"]
    assert verdict.reasons[0].value == pytest.approx(value)
    assert verdict.reasons[0].limit == limit
    assert figures in verdict.reasons[0].text


@pytest.mark.parametrize(
    ("held_by", "structure", "explained"),
    [
        (5.0, (90, 4, 300), 0.25),
        (5.0, (90, 9, 0), 0.25),
        (50.0, (5, 0, 285), 0.05),
    ],
    ids=["hidden", "in empty space", "hidden, firmly held"],
)
def test_structure_that_is_hidden_or_in_empty_space_leaves_it_undecided(held_by, structure, explained):
    verdict = decide([_answer(agree=2000, held_by=held_by, structure=structure)], _CONFIG)
    assert verdict.outcome == "undecided"
    assert _codes(verdict) == ["structure_unexplained"]
    assert verdict.reasons[0].value == pytest.approx(explained)
    for figure in (f"{structure[0]} points", f"{structure[2]} are hidden", f"{structure[1]} stand", f"{explained:.0%}"):
        assert figure in verdict.reasons[0].text


@pytest.mark.parametrize(("held_by", "limit_m"), [(5.0, 5.0), (50.0, 15.0)], ids=["loosely", "firmly"])
def test_lidars_of_one_vehicle_are_not_farther_apart_than_it_is_long(held_by, limit_m):
    near, far = (
        decide([_answer(RigidTransform.from_xyz_rpy("t", "s", (x_m, 0.0, 0.0), (0, 0, 0)), held_by=held_by)], _CONFIG)
        for x_m in (limit_m, limit_m + 0.1)
    )
    assert near.accepted
    assert far.outcome == "undecided"
    assert _codes(far) == ["too_far_apart"]
    assert f"up to {limit_m:g} m (verify." in far.reasons[0].text


def test_parallax_is_allowed_to_hide_much_where_the_pose_is_firmly_held():
    assert decide([_answer(agree=9000, held_by=50.0, structure=(95, 2, 300))], _CONFIG).accepted


def test_what_is_wrong_outweighs_what_is_doubtful_and_all_is_said():
    verdict = decide([_answer(agree=99, plane=75.0, curvature=0.1), _answer(_ELSEWHERE, agree=425)], _CONFIG)
    assert verdict.outcome == "reject"
    assert _codes(verdict) == ["too_little_overlap", "too_little_evidence", "ambiguous", "not_observable"]


def test_evidence_below_zero_is_told_as_none():
    verdict = decide([_answer(agree=900, violate=100), _answer(_ELSEWHERE)], _CONFIG)
    assert _codes(verdict) == ["empty_space_violated", "too_little_evidence"]
    assert "rests on 0 distinctive" in verdict.reasons[1].text


@pytest.mark.parametrize(
    ("exactly", "limits"),
    [
        (_answer(agree=150, plane=10.0), {"min_agree": 150}),
        (_answer(agree=990, violate=10, plane=100.0), {"max_violation_share_firm": 0.01}),
        (_answer(agree=520, plane=400.0), {"min_evidence": 120.0}),
        (_answer(curvature=0.2), {"min_curvature": 0.2}),
        (_answer(held_by=1.0, structure=(90, 0, 100)), {"min_explained": 0.5}),
        (replace(_answer(), hold=_HELD), {"max_pushed_off_m": 0.001, "max_thinned_off_m": 0.01}),
        (replace(_answer(), hold=_HELD), {"max_sigma_m": 0.005, "max_sigma_deg": float(np.rad2deg(1e-4))}),
        (replace(_answer(), hold=replace(_HELD, sigma_m=None, sigma_rad=None)), {}),
    ],
)
def test_a_figure_that_meets_its_limit_passes(exactly, limits):
    assert decide([exactly], _CONFIG.model_copy(update=limits)).accepted


@pytest.mark.parametrize(("fitness", "outcome"), [(0.0, "reject"), (0.199, "reject"), (0.2, "accept"), (0.9, "accept")])
def test_without_verification_the_papers_gate_decides(fitness, outcome):
    pair = PairRegistration("t", "s", _POSE, fitness, 0.1, 10, converged=True, iterations=3, engine="test")
    verdict = decide_by_fitness(pair, MergeConfig())
    assert verdict.outcome == outcome
    if outcome == "reject":
        assert _codes(verdict) == ["low_fitness"]
        assert (verdict.reasons[0].value, verdict.reasons[0].limit) == (fitness, 0.2)
        assert f"fitness {fitness:.3f} is below 0.2" in verdict.reasons[0].text
