# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from multilica.acceptance.accept import competing_poses, slides
from multilica.config import AcceptanceConfig, CalibrationConfig, with_overrides
from multilica.geometry import RigidTransform
from multilica.registration.gicp import register
from multilica.registration.plane_fit import PlaneFit
from multilica.registration.sensor_biases import BIAS_COUNT, prior_sigmas
from multilica.registration.stability import perturbed_ends
from multilica.results import BiasInformation, Hypothesis
from multilica.stages import fine
from multilica.stages.fine import register_best, select_finalists
from multilica.visibility.registration_cloud import prepare_registration_cloud
from multilica.visibility.sensor_view import prepare_sensor_view
from tests.selection import some_of
from tests.unit.made_rooms import AISLE, HALL, box, scan

_CONFIG = CalibrationConfig()
_NEVER_FIRM = with_overrides(_CONFIG, ["acceptance.min_well_constrained_eigenvalue=1e9"])
_TARGET = RigidTransform.from_xyz_rpy("world", "t", [-1.0, 0.0, 1.8], [0.03, 0.1, 0.4])
_SOURCE = RigidTransform.from_xyz_rpy("world", "s", [1.0, 0.8, 1.6], [-0.1, 0.2, -1.2])
_PLACES = (("t", _TARGET), ("s", _SOURCE))
_TRUTH = _TARGET.inverse() @ _SOURCE
_HALF_TURN = _TARGET.inverse() @ RigidTransform.from_xyz_rpy("world", "world", [0, 0, 0], [0, 0, np.pi]) @ _SOURCE

_TWOFOLD = [
    ((-12.0, -7.0, 0.0), (12.0, 7.0, 4.0)),
    ((4.0, 3.0, 0.0), (5.0, 4.0, 4.0)),
    ((-5.0, -4.0, 0.0), (-4.0, -3.0, 4.0)),
    ((6.0, -6.0, 0.0), (9.0, -5.0, 1.5)),
    ((-9.0, 5.0, 0.0), (-6.0, 6.0, 1.5)),
]


def _near(pose, xyz_m=(0.1, -0.1, 0.05), yaw_rad=0.02):
    return RigidTransform.from_xyz_rpy("t", "t", xyz_m, [0.0, 0.0, yaw_rad]) @ pose


def _side(cloud, *, verified=True):
    view = (RigidTransform.identity(cloud.lidar, cloud.lidar), prepare_sensor_view(cloud))
    return prepare_registration_cloud(cloud.lidar, cloud.points_m, [view] if verified else [], _CONFIG)


@pytest.fixture(scope="module")
def clouds():
    return scan("t", _TARGET, HALL, columns=720), scan("s", _SOURCE, HALL, seed=1)


@pytest.fixture(scope="module")
def sides(clouds):
    return tuple(_side(cloud) for cloud in clouds)


def _hypothesis(pose, index=0, **known):
    return Hypothesis(pose, index=index, **known)


def _with_gicp(sides, **changed):
    return [replace(side, finalist_gicp=_CONFIG.fine.model_copy(update=changed)) for side in sides]


def _assert_true(pose, truth=_TRUTH):
    metres, radians = pose.distance_to(truth)
    assert metres < 0.01
    assert radians < np.deg2rad(0.1)


def test_the_pose_with_the_most_evidence_is_registered_finely(sides):
    wrong, right = _hypothesis(_near(_HALF_TURN)), _hypothesis(_near(_TRUTH), 7)
    result = register_best(*sides, [wrong, right], _CONFIG)
    assert (result.target, result.source) == ("t", "s")
    _assert_true(result.T_target_source)
    assert result.hypothesis == 7
    chosen, *others = result.registrations
    assert chosen.T_target_source is result.T_target_source
    assert chosen.hypothesis == 7
    assert result.evidence == chosen.evidence > 0
    assert all(other.evidence < chosen.evidence - _CONFIG.acceptance.min_log_odds_margin for other in others)
    assert chosen.visibility.contradiction < _CONFIG.acceptance.min_log_odds_margin
    assert chosen.weakest_curvature > 1.0


def test_the_narrower_side_is_the_source_whichever_comes_first(sides):
    backwards = register_best(*reversed(sides), [_hypothesis(_near(_TRUTH).inverse())], _CONFIG)
    assert (backwards.target, backwards.source) == ("t", "s")
    _assert_true(backwards.T_target_source)


def test_hypotheses_with_one_end_count_once(sides):
    hypotheses = [_hypothesis(_near(_TRUTH, (shift, 0.0, 0.0)), index) for index, shift in enumerate((0.0, 0.1, 0.4))]
    result = register_best(*sides, hypotheses, _CONFIG)
    assert len(result.registrations) == 1
    _assert_true(result.T_target_source)


def test_finalists_with_one_end_are_registered_on_all_points(sides, monkeypatch):
    registered = []

    def counted(target, source, *rest):
        registered.append(len(source.points_m))
        return register(target, source, *rest)

    monkeypatch.setattr(fine, "register", counted)
    hypotheses = [_hypothesis(_near(_TRUTH, (shift_m, 0.0, 0.0))) for shift_m in (-0.2, 0.2)]
    result = register_best(*_with_gicp(sides, max_points=1500), hypotheses, _CONFIG)
    assert len(result.registrations) == 1
    assert max(registered[:2]) < 1500 < registered[2] == len(sides[1].cloud.points_m)
    _assert_true(result.T_target_source)


def test_a_pose_that_all_points_lead_away_gives_way(monkeypatch):
    """Both poses fit a hall that looks the same turned; on all points, GICP leaves the one with more evidence."""
    hall = [face for lo_m, hi_m in _TWOFOLD for face in box(lo_m, hi_m)]
    alike = [_side(scan(name, at, hall, seed=number)) for number, (name, at) in enumerate(_PLACES)]
    sides = _with_gicp(alike, max_points=5000)

    def led_away(target, source, pose, config):
        found = register(target, source, pose, config)
        leaves = pose.distance_to(_HALF_TURN)[0] < 1.0 and len(source.points_m) > 5000
        return replace(found, T_target_source=_near(_HALF_TURN, (0.6, 0.0, 0.0))) if leaves else found

    hypotheses = [_hypothesis(_near(_TRUTH)), _hypothesis(_near(_HALF_TURN), 7)]
    _assert_true(register_best(*sides, hypotheses, _CONFIG).T_target_source, _HALF_TURN)
    monkeypatch.setattr(fine, "register", led_away)
    result = register_best(*sides, hypotheses, _CONFIG)
    _assert_true(result.T_target_source)
    assert result.evidence > _CONFIG.acceptance.min_evidence
    _assert_true(competing_poses(result.registrations, _CONFIG.acceptance)[0].T_target_source, _HALF_TURN)


def test_no_more_finalists_are_registered_than_asked_for(sides):
    poses = [_near(_TRUTH, (0.0, 0.0, 0.0), yaw) for yaw in (0.0, 0.8, 1.6, 2.4, 3.2)]
    hypotheses = [_hypothesis(pose, index) for index, pose in enumerate(poses)]
    result = register_best(*sides, hypotheses, with_overrides(_CONFIG, ["fine.max_finalists=2"]))
    assert len(result.registrations) <= 2
    assert result.hypothesis == 0


@pytest.mark.parametrize(
    ("evidence", "kept"),
    [
        ([-20.0, 10.0, 5.0, 3.0], [1, 2]),
        ([9.0, 2.3, 2.5], [0, 2]),
        ([-9.0, -4.0, -4.1], [1]),
        ([], []),
    ],
    ids=["the best first", "more than the lead behind", "none may be accepted", "none"],
)
def test_hopeless_poses_are_no_finalists(evidence, kept):
    assert select_finalists(evidence, AcceptanceConfig(), 16) == kept


@pytest.mark.slow
@pytest.mark.in_turn
def test_the_stability_is_tested_if_a_pose_competes(sides):
    alone = register_best(*sides, [_hypothesis(_near(_TRUTH))], _CONFIG)
    assert (
        alone.registrations[0].visibility.min_information_eigenvalue
        > _CONFIG.acceptance.min_well_constrained_eigenvalue
    )
    assert alone.registrations[0].stability is None
    alike = [*HALL[:6], *box((4.0, 3.0, 0.0), (5.0, 4.0, 4.0)), *box((-5.0, -4.0, 0.0), (-4.0, -3.0, 4.0))]
    both = [_side(scan(name, pose, alike, seed=seed)) for seed, (name, pose) in enumerate(_PLACES)]
    hypotheses = [_hypothesis(_near(pose), index) for index, pose in enumerate((_TRUTH, _HALF_TURN))]
    best = register_best(*both, hypotheses, _CONFIG).registrations[0]
    assert best.visibility.min_information_eigenvalue > _CONFIG.acceptance.min_well_constrained_eigenvalue
    assert best.stability.perturbed_offset_m < 1e-3


def test_the_pose_of_gicp_is_fitted_to_planes(sides, monkeypatch):
    elsewhere = _near(_TRUTH, (0.004, 0.0, 0.0), 0.0)
    information = np.diag([1e8] * 3 + [1e6] * 3)
    whole = np.eye(6 + 2 * BIAS_COUNT)
    of_biases = BiasInformation(whole, whole[0], whole, whole, np.zeros(2 * BIAS_COUNT))
    fitted = PlaneFit(elsewhere, information, of_biases)
    allowed = []

    def fit(_target, _source, _pose, bias_sigmas):
        allowed.append(bias_sigmas)
        return fitted

    monkeypatch.setattr(fine, "fit_planes", fit)
    others = ["elevation_bias_sigma_deg=0.1", "range_scale_sigma=3e-4", "glancing_bias_sigma_m=0.007"]
    overrides = [f"refine.{each}" for each in ("range_bias_sigmas_m.s=0.03", *others)]
    config = with_overrides(_CONFIG, overrides)
    result = register_best(*sides, [_hypothesis(_near(_TRUTH))], config)
    assert result.T_target_source is elsewhere
    assert result.registrations[0].T_target_source is elsewhere
    assert result.information is information
    assert result.bias_information is fitted.biases
    of_target, of_source = (prior_sigmas(name, config.refine) for name in "ts")
    assert of_source[0] == 0.03 != of_target[0]
    assert np.array_equal(allowed, [[*of_target, *of_source]])
    assert np.allclose(of_target[1:], [np.deg2rad(0.1), 3e-4, 0.007])


def test_a_group_has_no_biases_of_its_own(clouds, sides):
    target, source = sides
    both = [(RigidTransform.identity("t", "t"), target.views[0][1]), (_TRUTH, source.views[0][1])]
    group = prepare_registration_cloud("t", clouds[0].points_m, both, _CONFIG)
    result = register_best(group, source, [_hypothesis(_near(_TRUTH))], _CONFIG)
    assert result.bias_information is None
    assert result.information is not None


@pytest.mark.slow
@pytest.mark.in_turn
def test_a_pushed_pose_is_less_certain_with_its_biases(sides, monkeypatch):
    sure = register_best(*sides, [_hypothesis(_near(_TRUTH))], _CONFIG)
    monkeypatch.setattr(fine, "perturbed_ends", lambda *_: (_near(_TRUTH, (0.03, 0.0, 0.0)), _TRUTH))
    unsure = register_best(*sides, [_hypothesis(_near(_TRUTH))], _NEVER_FIRM)
    direction = np.zeros(len(sure.bias_information.information))
    direction[:6] = unsure.registrations[0].visibility.weakest_direction / np.repeat([10.0, 1.0], 3)
    for widened, before, along in (
        (unsure.information, sure.information, direction[:6]),
        (unsure.bias_information.information, sure.bias_information.information, direction),
    ):
        assert along @ widened @ along < 1.1 / unsure.registrations[0].stability.perturbed_offset_m ** 2
        assert along @ before @ along > 1e3


def test_without_the_fit_there_is_no_information(sides, monkeypatch):
    monkeypatch.setattr(fine, "fit_planes", pytest.fail)
    result = register_best(*sides, [_hypothesis(_near(_TRUTH))], _CONFIG, fit=False)
    _assert_true(result.T_target_source)
    assert result.information is None
    assert result.evidence > _CONFIG.acceptance.min_evidence


@pytest.mark.parametrize(("offset_m", "needs_gicp"), [(0.01, False), (0.025, False), (0.06, True)])
def test_gicp_follows_a_known_pose_only_if_it_moved(sides, offset_m, needs_gicp):
    expected = register_best(*sides, [_hypothesis(_near(_TRUTH))], _CONFIG)
    known = _hypothesis(_near(expected.T_target_source, (offset_m, 0.0, 0.0), 0.0))
    found = register_best(*sides, [known], _CONFIG, is_known=True)
    assert (found.iterations is not None) == needs_gicp
    assert found.fitness == pytest.approx(expected.fitness, rel=0.01)
    off = found.T_target_source.offset_from(expected.T_target_source)
    assert np.all(np.abs(off) < np.repeat([np.deg2rad(0.005), 5e-4], 3))


def test_a_loose_known_pose_is_not_fitted_before_gicp(sides, monkeypatch):
    monkeypatch.setattr(fine, "fit_planes", pytest.fail)
    monkeypatch.setattr(fine, "register", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        register_best(*sides, [_hypothesis(_TRUTH)], _NEVER_FIRM, is_known=True)


def test_only_finalists_that_may_win_go_on(sides, monkeypatch):
    went_on = []

    def watched(target, source, pose, gicp):
        if gicp.max_iterations == _CONFIG.fine.max_iterations:
            went_on.append(pose.distance_to(_TRUTH)[1] < 0.1)
        return register(target, source, pose, gicp)

    monkeypatch.setattr(fine, "register", watched)
    hypotheses = [_hypothesis(_near(pose, yaw_rad=0.05), evidence=1.0) for pose in (_HALF_TURN, _TRUTH)]
    result = register_best(*_with_gicp(sides, max_iterations=1), hypotheses, _CONFIG)
    _assert_true(result.T_target_source)
    assert len(went_on) >= 2
    assert all(went_on)


@pytest.mark.parametrize(
    ("sigma_m", "sigma_deg", "tested"), [(0.009, 0.09, False), (0.011, 0.0, True), (0.0, 0.11, True)]
)
def test_the_stability_of_an_uncertain_pose_is_tested(sides, monkeypatch, sigma_m, sigma_deg, tested):
    monkeypatch.setattr(fine, "weakest_sigmas", lambda _: (sigma_m, np.deg2rad(sigma_deg)))
    result = register_best(*sides, [_hypothesis(_near(_TRUTH))], _CONFIG)
    assert (result.registrations[0].stability is not None) is tested


def test_fewer_points_are_registered_only_if_there_are_many(sides):
    off_m = []
    for most in (1_000_000, 1500):
        found = register_best(*_with_gicp(sides, max_points=most), [_hypothesis(_near(_TRUTH))], _NEVER_FIRM)
        off_m.append(found.registrations[0].stability.thinned_offset_m)
    assert off_m[0] < 1e-9
    assert 1e-6 < off_m[1] < 0.05


@pytest.mark.slow
def test_a_registration_that_stopped_short_is_moved_on(sides, monkeypatch):
    def stopping_short(target, source, start, *rest):
        monkeypatch.setattr(fine, "register", register)
        registered = register(target, source, start, *rest)
        pose = registered.T_target_source
        short = RigidTransform.from_rotation_translation("t", "s", pose.rotation, np.add(pose.xyz_m, [0.03, 0.0, 0.0]))
        return replace(registered, T_target_source=short)

    monkeypatch.setattr(fine, "register", stopping_short)
    result = register_best(*sides, [_hypothesis(_near(_TRUTH), 3)], _NEVER_FIRM)
    _assert_true(result.T_target_source)
    (best,) = result.registrations
    assert best.T_target_source is result.T_target_source
    assert best.hypothesis == 3
    assert best.stability.perturbed_offset_m < 1e-3


def _pushed_apart(ends, registered):
    """Replace the ends of perturbed registrations of fewer points, and count those of all points."""

    def perturbed(clouds, pose, *rest):
        if len(clouds[1].points_m) < 1500:
            return ends
        registered.append(pose)
        return perturbed_ends(clouds, pose, *rest)

    return perturbed


@pytest.mark.parametrize(("far_m", "all_points"), [(0.26, 1), (0.32, 0)])
def test_a_pose_that_few_points_do_not_hold_slides(sides, monkeypatch, far_m, all_points):
    registered = []
    ends = _near(_TRUTH, yaw_rad=0.0), _near(_TRUTH, (far_m, 0.0, 0.0), 0.0)
    monkeypatch.setattr(fine, "perturbed_ends", _pushed_apart(ends, registered))
    result = register_best(*_with_gicp(sides, max_points=1500), [_hypothesis(_near(_TRUTH))], _NEVER_FIRM)
    assert len(registered) == all_points
    stability = result.registrations[0].stability
    assert slides(stability, _CONFIG.acceptance) is not bool(all_points)
    if not all_points:
        assert stability.perturbed_offset_m == stability.thinned_offset_m == pytest.approx(far_m, abs=0.02)


@pytest.fixture(scope="module")
def corridor():
    """Two sensors in a long corridor, where only a locker constrains the pose along it."""
    objects = [*box((-60.0, -2.0, 0.0), (60.0, 2.0, 3.0)), *box((3.0, 1.2, 0.0), (4.5, 2.0, 3.0))]
    return tuple(_side(scan(name, pose, objects, seed=seed, columns=720)) for seed, (name, pose) in enumerate(_PLACES))


@pytest.mark.slow
@pytest.mark.in_turn
@pytest.mark.parametrize("along_m", some_of([-1.0, 3.0], 1))
def test_a_sliding_pose_is_searched_along_the_slide(corridor, along_m, monkeypatch):
    start = _TARGET.inverse() @ RigidTransform.from_xyz_rpy("world", "world", [along_m, 0, 0], [0, 0, 0]) @ _SOURCE
    best, *others = register_best(*corridor, [_hypothesis(start, 4, origin="cliques")], _CONFIG).registrations
    _assert_true(best.T_target_source)
    assert best.stability.perturbed_offset_m < _CONFIG.acceptance.max_perturbed_offset_m
    assert best.hypothesis == 4
    assert all(other.evidence < best.evidence for other in others)
    monkeypatch.setattr(fine, "slid_hypotheses", lambda *_: [])
    (stuck,) = register_best(*corridor, [_hypothesis(start, 4)], _CONFIG).registrations
    assert stuck.T_target_source.distance_to(_TRUTH)[0] > 1.0
    assert stuck.stability.perturbed_offset_m > _CONFIG.acceptance.max_perturbed_offset_m


@pytest.mark.slow
def test_few_points_lead_from_a_slid_pose_to_the_true_one(corridor, monkeypatch):
    """The slid pose stays a competing one."""
    monkeypatch.setattr(fine, "slid_hypotheses", lambda *_: [])
    monkeypatch.setattr(fine, "perturbed_ends", _pushed_apart((_TRUTH, _TRUTH), []))
    slid = _TARGET.inverse() @ RigidTransform.from_xyz_rpy("world", "world", [3.0, 0, 0], [0, 0, 0]) @ _SOURCE
    found = register_best(*_with_gicp(corridor, max_points=1500), [_hypothesis(slid, 4)], _CONFIG)
    best, other = found.registrations
    _assert_true(best.T_target_source)
    assert best.hypothesis == 4
    assert best.stability.perturbed_offset_m < _CONFIG.acceptance.max_perturbed_offset_m
    assert other.T_target_source.distance_to(_TRUTH)[0] > 1.0


@pytest.mark.slow
def test_few_points_do_not_lead_to_a_pose_with_less_evidence(corridor, monkeypatch):
    slid = _TARGET.inverse() @ RigidTransform.from_xyz_rpy("world", "world", [3.0, 0, 0], [0, 0, 0]) @ _SOURCE
    monkeypatch.setattr(fine, "slid_hypotheses", lambda *_: [])
    monkeypatch.setattr(fine, "perturbed_ends", _pushed_apart((slid, slid), []))
    found = register_best(
        *_with_gicp(corridor, max_points=1500), [_hypothesis(_near(_TRUTH, yaw_rad=0.0))], _NEVER_FIRM
    )
    _assert_true(found.T_target_source)
    assert slides(found.registrations[0].stability, _CONFIG.acceptance)


@pytest.mark.slow
@pytest.mark.in_turn
def test_groups_have_competing_poses_where_the_scene_repeats():
    """Pillars repeat every 3 m; pairs get such poses before, but groups have fewer of them."""
    clouds = [scan(name, at, AISLE, seed=seed, columns=720) for seed, (name, at) in enumerate(_PLACES)]
    group, single = (_side(cloud) for cloud in clouds)
    group = replace(group, views=(*group.views, *group.views))
    start = [_hypothesis(_near(_TRUTH))]
    assert len(register_best(group, single, start, _CONFIG, fit=False).registrations) == 1
    found = register_best(group, single, start, _CONFIG).registrations
    assert competing_poses(found, _CONFIG.acceptance)
    assert any(each.derivation.startswith("repeated after ") for each in found)


def test_without_views_the_first_hypothesis_is_taken(clouds):
    sides = [_side(cloud, verified=False) for cloud in clouds]
    hypotheses = [_hypothesis(_near(_TRUTH), 3), _hypothesis(_near(_HALF_TURN))]
    right, wrong = (register_best(*sides, order, _CONFIG) for order in (hypotheses, hypotheses[::-1]))
    _assert_true(right.T_target_source)
    assert (right.hypothesis, wrong.hypothesis) == (3, 0)
    assert wrong.T_target_source.distance_to(_TRUTH)[1] > 1.0
    assert right.registrations == wrong.registrations == ()
    assert right.evidence == right.fitness > wrong.fitness
