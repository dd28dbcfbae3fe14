# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from multilica.acceptance.accept import (
    accept,
    accept_by_fitness,
    cannot_be_accepted,
    competing_poses,
    is_well_constrained,
    may_be_accepted,
    min_competing_evidence,
)
from multilica.acceptance.placement import imprecision, place
from multilica.config import AcceptanceConfig, MergeConfig
from multilica.results import PairRegistration, Stability
from tests.unit.acceptance.made_registrations import ELSEWHERE, HERE, registration
from tests.unit.made_pairs import pose

_CONFIG = AcceptanceConfig()
_STABLE = Stability(sigma_m=0.005, sigma_rad=1e-4, perturbation_m=0.3, perturbed_offset_m=0.001, thinned_offset_m=0.01)


def _accept(*registrations, **changed):
    return accept(registrations, _CONFIG.model_copy(update=changed))


def test_a_clear_registration_is_accepted_without_reasons():
    verdict = _accept(registration(stability=_STABLE), registration(ELSEWHERE, distinctive=100))
    assert verdict.outcome == "accept"
    assert verdict.accepted
    assert verdict.reasons == ()


_FAR = pose("t", "s", (14.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("weak", "code", "text"),
    [
        (registration(distinctive=20), "too_little_evidence", "only 20 points lie on walls and objects"),
        (registration(violate=30), "empty_space_violated", "2.1% of the points lie in space"),
        (registration(structure=(0, 5000)), "structure_unexplained", "5000 of 5000 points on walls and objects"),
        (registration(_FAR, distinctive=300), "too_far_apart", "the LiDARs would be 14.0 m apart"),
    ],
    ids=["few points", "empty space", "hidden", "far apart"],
)
def test_a_pose_with_too_little_evidence_names_its_weakness(weak, code, text):
    verdict = _accept(weak)
    assert verdict.outcome == "reject"
    assert verdict.codes == (code,)
    (reason,) = verdict.reasons
    assert (reason.value, reason.limit) == (weak.evidence, _CONFIG.min_evidence)
    assert reason.value < reason.limit
    assert reason.text.startswith(text)
    assert reason.text.endswith(f"(evidence {weak.evidence:z.1f}, limit 2.3)")


@pytest.mark.parametrize("derivation", ["turned by 180 deg", "repeated after 7.5 m", "slid by +2 m"])
def test_a_derived_pose_needs_more_evidence(derivation):
    """It is one of several that were tried; a pose that other pairs imply is the only one."""
    found = registration(distinctive=60)
    assert _CONFIG.min_evidence < found.evidence < _CONFIG.min_evidence + np.log(6.0)
    assert _accept(found).accepted
    verdict = _accept(replace(found, derivation=derivation))
    assert (verdict.outcome, verdict.codes) == ("reject", ("too_little_evidence",))
    assert verdict.text.endswith("limit 4.1)")
    assert _accept(replace(found, derivation="a-b-c", hypothesis=-1)).accepted
    assert _accept(replace(registration(), derivation=derivation)).accepted


def test_the_worst_weakness_is_first_slight_ones_are_left_out():
    assert _accept(registration(distinctive=20, violate=8)).codes == ("empty_space_violated", "too_little_evidence")
    assert _accept(registration(distinctive=20, violate=300)).codes == ("empty_space_violated",)
    assert _accept(registration(distinctive=4, structure=(10, 90))).codes == ("too_little_evidence",)


@pytest.mark.parametrize(
    "flaw",
    [{"violate": 15}, {"structure": (100, 900)}, {"at": pose("t", "s", (12.0, 0.0, 0.0))}],
    ids=["empty space", "hidden", "far apart"],
)
def test_no_weakness_outweighs_any_number_of_points(flaw):
    few, many = (_accept(registration(**flaw, distinctive=distinctive)) for distinctive in (100, 4000))
    assert few.outcome == "reject"
    assert many.accepted


def test_lidars_beyond_the_baseline_are_rejected():
    limit_m = _CONFIG.max_baseline_m
    near, far = (
        _accept(registration(pose("t", "s", (x_m, 0.0, 0.0)), distinctive=100_000)) for x_m in (limit_m, limit_m + 0.1)
    )
    assert near.accepted
    assert far.outcome == "reject"
    assert far.codes == ("too_far_apart",)
    assert (far.reasons[0].value, far.reasons[0].limit) == pytest.approx((15.1, 15.0))
    assert "15.1 m apart, limit 15 m (acceptance.max_baseline_m)" in far.text


def test_a_competing_pose_leaves_it_undecided():
    best, competing = registration(), registration(ELSEWHERE)
    verdict = _accept(best, competing)
    assert verdict.outcome == "undecided"
    assert not verdict.accepted
    assert verdict.codes == ("ambiguous",)
    (reason,) = verdict.reasons
    assert reason.competing is competing
    assert reason.value == pytest.approx(best.evidence - competing.evidence)
    assert 0.0 < reason.value < reason.limit == _CONFIG.min_log_odds_margin
    odds = f"evidence {competing.evidence:.1f} against {best.evidence:.1f}, required margin 4.6"
    assert reason.text == f"a pose 5.00 m and 90 deg away fits as well ({odds})"


def test_the_likeliest_competing_pose_is_named():
    poses = [registration(ELSEWHERE, distinctive=distinctive) for distinctive in (400, 420, 20)]
    best = registration()
    assert competing_poses([best, *poses], _CONFIG) == [poses[1], poses[0]]
    assert _accept(best, *poses).reasons[0].competing is poses[1]


def test_a_competing_pose_along_the_slide_is_not_observable():
    weakest_x = np.diag([300.0, 300.0, 300.0, 50.0, 300.0, 1000.0])
    best = registration()
    best = replace(best, visibility=replace(best.visibility, information=weakest_x))
    slid, beside = (pose("t", "s", xyz_m) for xyz_m in ((2.0, 0.1, 0.0), (0.1, 2.0, 0.0)))
    along, across = (_accept(best, registration(at)) for at in (slid, beside))
    assert (along.codes, across.codes) == (("not_observable",), ("ambiguous",))
    assert "does not constrain the pose along x of t: a pose 2.00 m away fits as well" in along.text
    assert along.reasons[0].competing is None
    sliding = replace(best, stability=replace(_STABLE, perturbed_offset_m=0.3))
    both = _accept(sliding, registration(slid))
    assert both.codes == ("not_observable",)
    assert "perturbed by" in both.text


@pytest.mark.parametrize("which", ["best", "competing"])
def test_a_competing_pose_where_the_scene_repeats_is_named_so(which):
    repeated = pose("t", "s", (0.0, 7.5, 0.0))
    best, competing = registration(), registration(repeated)
    if which == "best":
        best = replace(best, derivation="repeated after 7.5 m")
    else:
        competing = replace(competing, derivation="repeated after 7.5 m")
    verdict = _accept(best, competing)
    assert (verdict.outcome, verdict.codes) == ("undecided", ("held_by_repetition",))
    assert verdict.text.startswith("the scene repeats: a pose 7.50 m away fits as well")
    assert verdict.reasons[0].competing is competing
    turned = replace(competing, T_target_source=ELSEWHERE, derivation="turned by 90 deg")
    assert _accept(best, turned).codes == ("ambiguous",)


def test_poses_compete_by_the_points_where_they_differ():
    """Chance excuses 3 of 1000 points in empty space, but not those that only one of two poses puts there."""
    violating = np.zeros((2, 20), dtype=bool)
    violating[0, :12] = True
    clean, dirty = (
        replace(each, visibility=replace(each.visibility, violating=where))
        for each, where in (
            (registration(distinctive=9000), violating[1]),
            (registration(ELSEWHERE, distinctive=9000, violate=12), violating[0]),
        )
    )
    assert clean.evidence - dirty.evidence < _CONFIG.min_log_odds_margin
    assert competing_poses([clean, dirty], _CONFIG) == []
    assert _accept(clean, dirty).accepted
    (reason,) = _accept(dirty, clean).reasons
    assert (reason.code, reason.competing) == ("ambiguous", clean)
    assert reason.value == dirty.lead_over(clean) < 0.0


@pytest.mark.parametrize(
    ("moved", "value", "figures"),
    [
        ({"perturbed_offset_m": 0.26}, 0.26, "perturbed by 0.3 m it ends 0.26 m away, limit 0.15 m"),
        ({"thinned_offset_m": 0.75}, 0.75, "with fewer points it ends 0.75 m away, limit 0.15 m"),
    ],
    ids=["pushed", "thinned"],
)
def test_a_pose_that_slides_leaves_it_undecided(moved, value, figures):
    verdict = _accept(registration(stability=replace(_STABLE, **moved)))
    assert verdict.outcome == "undecided"
    assert verdict.codes == ("not_observable",)
    assert (verdict.reasons[0].value, verdict.reasons[0].limit) == (value, _CONFIG.max_perturbed_offset_m)
    assert "the scene does not constrain the pose about x of t" in verdict.text
    assert figures in verdict.text


def test_a_pose_needs_points_in_each_direction():
    """Two LiDARs that look apart in a garage: turned by 180 deg they share a wall, and slide along it."""
    verdict = _accept(registration(weakest=0.04, stability=_STABLE))
    assert verdict.outcome == "undecided"
    assert verdict.codes == ("not_observable",)
    assert verdict.text.endswith("constrain the pose about x of t: only 0.04 points hold it there (limit 0.1)")
    assert _accept(registration(weakest=0.2, stability=_STABLE)).accepted
    assert _accept(registration(weakest=0.04, stability=replace(_STABLE, sigma_m=0.03))).outcome == "undecided"


def test_lidars_side_by_side_count_points_twice():
    """In a tunnel, both see the niche that one would take for another."""
    found = [registration(weakest=0.15, stability=_STABLE)]
    assert accept(found, _CONFIG).accepted
    assert accept(found, _CONFIG, views=2).outcome == "undecided"


@pytest.mark.parametrize(
    ("sigma", "value", "limit", "text"),
    [
        ({"sigma_m": 0.03}, 0.03, _CONFIG.max_sigma_m, "sigma 30 mm, limit 20 mm"),
        ({"sigma_rad": 0.01}, np.rad2deg(0.01), _CONFIG.max_sigma_deg, "sigma 0.57 deg, limit 0.2 deg"),
    ],
    ids=["position", "rotation"],
)
def test_a_pose_with_a_large_sigma_alone_is_uncertain(sigma, value, limit, text):
    verdict = _accept(registration(stability=replace(_STABLE, **sigma)))
    assert verdict.outcome == "uncertain"
    assert not verdict.accepted
    assert verdict.codes == ("imprecise",)
    assert verdict.reasons[0].value == pytest.approx(value)
    assert verdict.reasons[0].limit == limit
    assert verdict.text == text


def test_a_higher_limit_accepts_an_uncertain_pose():
    imprecise = registration(stability=replace(_STABLE, sigma_m=0.03, sigma_rad=0.01))
    assert _accept(imprecise, max_sigma_m=0.05, max_sigma_deg=1.0).accepted


def test_a_doubt_outweighs_a_large_sigma():
    imprecise = registration(stability=replace(_STABLE, sigma_m=0.03))
    sliding = replace(imprecise, stability=replace(imprecise.stability, perturbed_offset_m=0.3))
    assert _accept(imprecise, registration(ELSEWHERE)).codes == ("ambiguous",)
    assert _accept(sliding, registration(ELSEWHERE)).codes == ("not_observable", "ambiguous")


def test_a_margin_asks_for_smaller_sigmas():
    assert imprecision(0.015, 1e-4, _CONFIG) is None
    assert imprecision(0.015, 1e-4, _CONFIG, margin=2.0).code == "imprecise"
    assert imprecision(None, None, _CONFIG) is None


@pytest.mark.parametrize(("sigma_m", "status"), [(0.005, "placed"), (2.9, "uncertain"), (3.1, "not_placed")])
def test_a_pose_that_nothing_holds_in_a_direction_is_none(sigma_m, status):
    along = np.array([0.6, 0.0, 0.8])
    covariance = 1e-8 * np.eye(6)
    covariance[3:, 3:] += sigma_m**2 * np.outer(along, along)
    prior = pose("left", "right")
    found = place(prior, covariance, _CONFIG, T_target_source_prior=prior)
    assert found.status == status
    assert (found.T_target_source is None) == (status == "not_placed")
    assert (found.covariance is None) == (status == "not_placed")
    assert found.T_target_source_prior is prior
    assert ("leaves its pose open" in found.reason) == (status == "not_placed")


_ONE = registration()


@pytest.mark.parametrize(
    ("exactly", "changed"),
    [
        (_ONE, {"min_evidence": _ONE.evidence}),
        (replace(_ONE, stability=_STABLE), {"max_sigma_m": 0.005, "max_sigma_deg": float(np.rad2deg(1e-4))}),
        (replace(_ONE, stability=_STABLE), {"max_perturbed_offset_m": 0.01}),
        (replace(_ONE, stability=replace(_STABLE, sigma_m=None, sigma_rad=None)), {}),
    ],
    ids=["evidence", "sigma", "return", "unknown sigma"],
)
def test_a_figure_that_meets_its_limit_passes(exactly, changed):
    assert _accept(exactly, **changed).accepted


def test_a_pose_is_firm_if_points_constrain_every_direction():
    assert [is_well_constrained(registration(weakest=weakest).visibility, _CONFIG) for weakest in (7.9, 8.0)] == [
        False,
        True,
    ]


def test_a_rough_pose_is_dropped_only_with_a_margin():
    assert [cannot_be_accepted(evidence, _CONFIG) for evidence in (0.2, 0.4, 3.0)] == [True, False, False]
    assert min_competing_evidence(10.0, _CONFIG) == pytest.approx(3.4)
    assert min_competing_evidence(-5.0, _CONFIG) == -5.0


@pytest.mark.parametrize(
    ("distinctive", "apart_m", "possible"),
    [
        ((), 2.0, False),
        ((20,), 2.0, False),
        ((400,), 2.0, True),
        ((400, 390), 2.0, False),
        ((400, 390), 0.5, True),
        ((400, 100), 2.0, True),
    ],
)
def test_what_may_be_accepted_has_no_equal_elsewhere(distinctive, apart_m, possible):
    found = [
        registration(pose("t", "s", (side * 0.5 * apart_m, 0, 0)), distinctive=count)
        for side, count in zip((1.0, -1.0), distinctive, strict=False)
    ]
    assert may_be_accepted(found, _CONFIG) is possible


@pytest.mark.parametrize(
    ("fitness", "outcome"), [(0.0, "reject"), (0.199, "reject"), (0.2, "reject"), (0.201, "accept")]
)
def test_without_verification_the_fitness_decides(fitness, outcome):
    pair = PairRegistration("t", "s", HERE, fitness, 0.1, 10, converged=True, iterations=3, engine="test")
    verdict = accept_by_fitness(pair, MergeConfig())
    assert verdict.outcome == outcome
    if outcome == "reject":
        assert verdict.codes == ("low_fitness",)
        assert (verdict.reasons[0].value, verdict.reasons[0].limit) == (fitness, 0.2)
        assert f"fitness {fitness:.3f} is not above 0.2" in verdict.reasons[0].text
