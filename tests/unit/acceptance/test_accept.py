# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from multilica.acceptance.accept import accept, accept_by_fitness
from multilica.config import AcceptanceConfig, MergeConfig, StabilityConfig
from multilica.geometry import RigidTransform
from multilica.results import PairRegistration, Registration, Stability, VisibilityScore

_CONFIG, _LIMITS = AcceptanceConfig(), StabilityConfig()
_POSE = RigidTransform.identity("t", "s")
_STABLE = Stability(sigma_m=0.005, sigma_rad=1e-4, push_m=0.3, pushed_off_m=0.001, thinned_off_m=0.01)
_ELSEWHERE = RigidTransform.from_xyz_rpy("t", "s", [3.0, 4.0, 0.0], [0.0, 0.0, np.pi / 2])


def _registration(
    pose=_POSE,
    *,
    agree=1000,
    violate=0,
    plane=400.0,
    min_information_eigenvalue=50.0,
    curvature=5.0,
    structure=(0, 0, 0),
):
    """Make a registration: `plane` of its points share one orientation, `structure` agrees, violates, is occluded."""
    rest = plane / 2.0
    information = np.diag([min_information_eigenvalue, rest, rest, rest, rest, plane])
    score = VisibilityScore(agree, violate, 0, 0, information, np.zeros(0, dtype=np.uint8), *structure)
    return Registration(0, pose, score, 0.8, 0.03, curvature, np.zeros((0, 3)))


def _codes(verdict):
    return [reason.code for reason in verdict.reasons]


def _accept(*registrations, limits=_LIMITS, **changed):
    return accept(registrations, _CONFIG.model_copy(update=changed), limits)


def test_a_clear_registration_is_accepted_without_reasons():
    verdict = _accept(_registration(), _registration(_ELSEWHERE, agree=500))
    assert verdict.outcome == "accept"
    assert verdict.accepted
    assert verdict.reasons == ()


def test_too_little_overlap_is_rejected():
    verdict = _accept(_registration(agree=99, plane=20.0))
    assert verdict.outcome == "reject"
    assert _codes(verdict) == ["too_little_overlap"]
    reason = verdict.reasons[0]
    assert (reason.value, reason.limit) == (99, 100)
    assert "only 99 points" in reason.text
    assert "limit 100" in reason.text


def test_points_in_proven_empty_space_are_rejected():
    verdict = _accept(_registration(agree=9800, violate=200))
    assert verdict.outcome == "reject"
    assert _codes(verdict) == ["empty_space_violated"]
    assert verdict.reasons[0].value == pytest.approx(0.02)
    assert verdict.reasons[0].limit == _CONFIG.max_violation_share_firm
    assert "2.0% of the points" in verdict.reasons[0].text
    assert "0.4%" in verdict.reasons[0].text


def test_a_pose_that_is_not_firm_may_violate_less():
    counts = {"agree": 9970, "violate": 30, "structure": (980, 0, 0)}
    loose, firm = (_accept(_registration(min_information_eigenvalue=least, **counts)) for least in (7.9, 8.0))
    assert _codes(loose) == ["empty_space_violated"]
    assert loose.reasons[0].limit == _CONFIG.max_violation_share
    assert firm.accepted


def test_two_points_in_empty_space_can_be_chance():
    few, more = (_accept(_registration(agree=300, plane=50.0, violate=violate)) for violate in (2, 3))
    assert few.accepted
    assert _codes(more) == ["empty_space_violated"]


def test_a_lidar_cannot_be_where_beams_pass_through():
    registration = _registration()
    floating = replace(registration, visibility=replace(registration.visibility, seen_through_m=6.2))
    verdict = _accept(floating)
    assert verdict.outcome == "reject"
    assert _codes(verdict) == ["place_proven_empty", "too_little_evidence"]
    assert "6.2 m away" in verdict.reasons[0].text


def test_agreement_on_one_plane_only_is_no_evidence():
    verdict = _accept(_registration(agree=1000, plane=975.0))
    assert verdict.outcome == "reject"
    assert _codes(verdict) == ["too_little_evidence"]
    assert verdict.reasons[0].value == pytest.approx(25.0)
    assert "25 points off the main plane" in verdict.reasons[0].text
    assert "limit 30" in verdict.reasons[0].text


def test_a_competing_pose_leaves_it_undecided():
    competing = _registration(_ELSEWHERE, agree=880, curvature=0.1)
    verdict = _accept(_registration(agree=1000), competing)
    assert verdict.outcome == "undecided"
    assert not verdict.accepted
    assert _codes(verdict) == ["ambiguous"]
    assert verdict.reasons[0].competing is competing
    assert verdict.reasons[0].value == pytest.approx(0.8)
    for figure in ("5.00 m and 90 deg", "80%", "70%"):
        assert figure in verdict.reasons[0].text


def test_a_pose_that_stands_alone_competes_with_less_evidence():
    standing = {"agree": 700, "plane": 400.0, "structure": (90, 0, 0)}
    best = _registration(agree=1400, structure=(400, 0, 0))
    verdict = _accept(best, _registration(_ELSEWHERE, **standing))
    assert _codes(verdict) == ["ambiguous"]
    assert verdict.reasons[0].value == pytest.approx(0.3)
    assert verdict.reasons[0].limit == _CONFIG.max_standing_share
    for weakness in (
        {"agree": 149, "plane": 0.0},
        {"min_information_eigenvalue": 0.05},
        {"curvature": 0.1},
        {"structure": (90, 0, 50)},
    ):
        assert _accept(best, _registration(_ELSEWHERE, **{**standing, **weakness})).accepted


@pytest.mark.parametrize("flaw", [{"curvature": 0.1}, {"violate": 6}, {"structure": (10, 5, 0)}])
def test_an_implausible_pose_does_not_compete(flaw):
    def far(distance_m, **counts):
        pose = RigidTransform.from_xyz_rpy("t", "s", (distance_m, 0.0, 0.0), (0, 0, 1.0))
        return _registration(pose, **{"agree": 1100, "min_information_eigenvalue": 5.0, **counts})

    best = _registration(agree=1100)
    assert _accept(best, far(6.0, **flaw)).accepted
    for competing in (far(6.0), far(4.0, **flaw), far(6.0, **{**flaw, "min_information_eigenvalue": 50.0})):
        verdict = _accept(best, competing)
        assert _codes(verdict) == ["ambiguous"]
        assert verdict.reasons[0].competing is competing


def test_a_competing_pose_along_the_slide_is_not_observable():
    weakest_x = np.diag([300.0, 300.0, 300.0, 50.0, 300.0, 400.0])
    best = _registration()
    best = replace(best, visibility=replace(best.visibility, information=weakest_x))
    slid, beside = (RigidTransform.from_xyz_rpy("t", "s", xyz_m, (0, 0, 0)) for xyz_m in ((2, 0.1, 0), (0.1, 2, 0)))
    along, across = (_accept(best, _registration(pose, agree=990)) for pose in (slid, beside))
    assert (_codes(along), _codes(across)) == (["not_observable"], ["ambiguous"])
    assert "does not constrain the pose along x of t: a pose 2.00 m away" in along.reasons[0].text
    assert along.reasons[0].competing is None
    flat = replace(best, weakest_curvature=0.1)
    assert _codes(_accept(flat, _registration(slid, agree=990))) == ["not_observable"]


@pytest.mark.parametrize(
    ("weak", "value", "limit", "figures"),
    [
        ({"curvature": 0.1}, 0.1, _CONFIG.min_curvature, "curvature 0.10, limit 0.2"),
        ({"pushed_off_m": 0.26}, 0.26, _LIMITS.max_pushed_off_m, "pushed by 0.3 m it ends 0.260 m away"),
        ({"thinned_off_m": 0.75}, 0.75, _LIMITS.max_thinned_off_m, "with fewer points it ends 0.75 m away"),
        ({"sigma_m": 0.03}, 0.03, _CONFIG.max_sigma_m, "sigma 30 mm, limit 20 mm"),
        ({"sigma_rad": 0.01}, np.rad2deg(0.01), _CONFIG.max_sigma_deg, "sigma 0.57 deg, limit 0.2 deg"),
        ({"curvature": 0.1, "pushed_off_m": 0.26}, 0.1, _CONFIG.min_curvature, "curvature 0.10"),
    ],
)
def test_an_unconstrained_pose_leaves_it_undecided(weak, value, limit, figures):
    unstable = {name: figure for name, figure in weak.items() if name != "curvature"}
    registration = _registration(curvature=weak.get("curvature", 5.0))
    verdict = _accept(replace(registration, stability=replace(_STABLE, **unstable)))
    assert verdict.outcome == "undecided"
    assert _codes(verdict) == ["not_observable"]
    assert verdict.reasons[0].value == pytest.approx(value)
    assert verdict.reasons[0].limit == limit
    assert figures in verdict.reasons[0].text


@pytest.mark.parametrize(
    ("min_information_eigenvalue", "structure", "explained"),
    [
        (5.0, (90, 4, 300), 0.25),
        (5.0, (90, 9, 0), 0.25),
        (50.0, (5, 0, 285), 0.05),
    ],
    ids=["hidden", "in empty space", "hidden, firm"],
)
def test_unexplained_structure_leaves_it_undecided(min_information_eigenvalue, structure, explained):
    verdict = _accept(
        _registration(agree=2000, min_information_eigenvalue=min_information_eigenvalue, structure=structure)
    )
    assert verdict.outcome == "undecided"
    assert _codes(verdict) == ["structure_unexplained"]
    assert verdict.reasons[0].value == pytest.approx(explained)
    for figure in (f"{structure[0]} points", f"{structure[2]} are hidden", f"{structure[1]} lie", f"{explained:.0%}"):
        assert figure in verdict.reasons[0].text


@pytest.mark.parametrize(("min_information_eigenvalue", "limit_m"), [(5.0, 5.0), (50.0, 15.0)], ids=["loose", "firm"])
def test_lidars_beyond_the_baseline_leave_it_undecided(min_information_eigenvalue, limit_m):
    near, far = (
        _accept(
            _registration(
                RigidTransform.from_xyz_rpy("t", "s", (x_m, 0.0, 0.0), (0, 0, 0)),
                min_information_eigenvalue=min_information_eigenvalue,
            )
        )
        for x_m in (limit_m, limit_m + 0.1)
    )
    assert near.accepted
    assert far.outcome == "undecided"
    assert _codes(far) == ["too_far_apart"]
    assert f"limit is {limit_m:g} m" in far.reasons[0].text


def test_parallax_may_hide_much_if_the_pose_is_firm():
    assert _accept(_registration(agree=9000, min_information_eigenvalue=50.0, structure=(95, 2, 300))).accepted


def test_a_rejection_lists_the_doubts_as_well():
    verdict = _accept(_registration(agree=99, plane=75.0, curvature=0.1), _registration(_ELSEWHERE, agree=425))
    assert verdict.outcome == "reject"
    assert _codes(verdict) == ["too_little_overlap", "too_little_evidence", "ambiguous", "not_observable"]


def test_evidence_below_zero_is_reported_as_none():
    verdict = _accept(_registration(agree=900, violate=100), _registration(_ELSEWHERE))
    assert _codes(verdict) == ["empty_space_violated", "too_little_evidence"]
    assert "the evidence is 0 points" in verdict.reasons[1].text


@pytest.mark.parametrize(
    ("exactly", "changed"),
    [
        (_registration(agree=150, plane=10.0), {"min_agreeing_points": 150}),
        (_registration(agree=990, violate=10, plane=100.0), {"max_violation_share_firm": 0.01}),
        (_registration(agree=520, plane=400.0), {"min_evidence": 120.0}),
        (_registration(curvature=0.2), {"min_curvature": 0.2}),
        (_registration(min_information_eigenvalue=1.0, structure=(90, 0, 100)), {"min_explained_share": 0.5}),
        (replace(_registration(), stability=_STABLE), {"max_sigma_m": 0.005, "max_sigma_deg": float(np.rad2deg(1e-4))}),
        (replace(_registration(), stability=replace(_STABLE, sigma_m=None, sigma_rad=None)), {}),
    ],
)
def test_a_figure_that_meets_its_limit_passes(exactly, changed):
    limits = StabilityConfig(max_pushed_off_m=0.001, max_thinned_off_m=0.01)
    assert _accept(exactly, limits=limits, **changed).accepted


@pytest.mark.parametrize(("fitness", "outcome"), [(0.0, "reject"), (0.199, "reject"), (0.2, "accept"), (0.9, "accept")])
def test_without_verification_the_fitness_decides(fitness, outcome):
    pair = PairRegistration("t", "s", _POSE, fitness, 0.1, 10, converged=True, iterations=3, engine="test")
    verdict = accept_by_fitness(pair, MergeConfig())
    assert verdict.outcome == outcome
    if outcome == "reject":
        assert _codes(verdict) == ["low_fitness"]
        assert (verdict.reasons[0].value, verdict.reasons[0].limit) == (fitness, 0.2)
        assert f"fitness {fitness:.3f} is below 0.2" in verdict.reasons[0].text
