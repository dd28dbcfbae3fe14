# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from multilica.config import FineConfig, RefineConfig, VerifyConfig
from multilica.geometry import RigidTransform
from multilica.stages import fine
from multilica.stages.fine import Candidate, hopeful, prepare_side, register_best
from multilica.stages.gicp import register
from multilica.stages.plane_fit import PlaneFit
from multilica.stages.witness import prepare_witness
from tests.unit.made_rooms import HALL, box, scan

_VERIFY, _FINE, _REFINE = VerifyConfig(), FineConfig(), RefineConfig()
_TARGET = RigidTransform.from_xyz_rpy("world", "t", [-1.0, 0.0, 1.8], [0.03, 0.1, 0.4])
_SOURCE = RigidTransform.from_xyz_rpy("world", "s", [1.0, 0.8, 1.6], [-0.1, 0.2, -1.2])
_PLACES = (("t", _TARGET), ("s", _SOURCE))
_TRUTH = _TARGET.inverse() @ _SOURCE
_HALF_TURN = _TARGET.inverse() @ RigidTransform.from_xyz_rpy("world", "world", [0, 0, 0], [0, 0, np.pi]) @ _SOURCE


def _near(pose, xyz_m=(0.1, -0.1, 0.05), yaw_rad=0.02):
    return RigidTransform.from_xyz_rpy("t", "t", xyz_m, [0.0, 0.0, yaw_rad]) @ pose


def _side(cloud, *, verified=True):
    witness = (RigidTransform.identity(cloud.lidar, cloud.lidar), prepare_witness(cloud, _VERIFY))
    return prepare_side(cloud.lidar, cloud.points_m, [witness] if verified else [], _VERIFY, _FINE, 1)


@pytest.fixture(scope="module")
def clouds():
    return scan("t", _TARGET, HALL), scan("s", _SOURCE, HALL, seed=1, columns=480)


@pytest.fixture(scope="module")
def sides(clouds):
    return tuple(_side(cloud) for cloud in clouds)


def _assert_true(pose, truth=_TRUTH):
    metres, radians = pose.distance_to(truth)
    assert metres < 0.01
    assert radians < np.deg2rad(0.1)


def test_the_answer_with_the_most_evidence_is_registered_to_the_last_millimetre(sides):
    wrong, right = Candidate(_near(_HALF_TURN), 0), Candidate(_near(_TRUTH), 7)
    result = register_best(*sides, [wrong, right], _VERIFY, _FINE, _REFINE, 1)
    assert (result.target, result.source) == ("t", "s")
    _assert_true(result.T_target_source)
    assert result.hypothesis == 7
    chosen, *others = result.assessments
    assert chosen.T_target_source is result.T_target_source
    assert chosen.hypothesis == 7
    assert result.evidence == chosen.evidence > 0
    assert all(other.evidence < 0.3 * chosen.evidence for other in others)
    assert chosen.testimony.violation_share < _VERIFY.max_violation_share
    assert chosen.weakest_curvature > _VERIFY.min_curvature


def test_the_narrower_side_is_the_source_whichever_comes_first(sides):
    backwards = register_best(*reversed(sides), [Candidate(_near(_TRUTH).inverse(), 0)], _VERIFY, _FINE, _REFINE, 1)
    assert (backwards.target, backwards.source) == ("t", "s")
    _assert_true(backwards.T_target_source)


def test_candidates_that_are_the_same_answer_count_once(sides):
    candidates = [Candidate(_near(_TRUTH, (shift, 0.0, 0.0)), index) for index, shift in enumerate((0.0, 0.1, 0.4))]
    result = register_best(*sides, candidates, _VERIFY, _FINE, _REFINE, 1)
    assert len(result.assessments) == 1
    _assert_true(result.T_target_source)


def test_finalists_that_end_at_one_answer_are_registered_on_all_points(sides, monkeypatch):
    few = _VERIFY.model_copy(update={"finalist_points": 1500})
    drafting = [replace(side, drafting=_FINE.model_copy(update={"max_points": 1500})) for side in sides]
    registered = []

    def counted(target, source, *rest):
        registered.append(len(source.points_m))
        return register(target, source, *rest)

    monkeypatch.setattr(fine, "register", counted)
    candidates = [Candidate(_near(_TRUTH, (shift_m, 0.0, 0.0)), 0) for shift_m in (-0.2, 0.2)]
    result = register_best(*drafting, candidates, few, _FINE, _REFINE, 1)
    assert len(result.assessments) == 1
    assert max(registered[:2]) < 1500 < registered[2] == len(sides[1].cloud.points_m)
    _assert_true(result.T_target_source)


def test_no_more_finalists_are_registered_than_asked_for(sides):
    poses = [_near(_TRUTH, (0.0, 0.0, 0.0), yaw) for yaw in (0.0, 0.8, 1.6, 2.4, 3.2)]
    candidates = [Candidate(pose, index) for index, pose in enumerate(poses)]
    result = register_best(*sides, candidates, _VERIFY.model_copy(update={"finalists": 2}), _FINE, _REFINE, 1)
    assert len(result.assessments) <= 2
    assert result.hypothesis == 0


@pytest.mark.parametrize(
    ("evidence", "kept"),
    [
        ([-900.0, 500.0, 130.0, 90.0], [1, 2]),
        ([310.0, 20.0, 5.0], [0, 1]),
        ([50.0, -240.0, -260.0], [0, 1]),
        ([-400.0, -750.0, -90.0], [2]),
        ([], []),
    ],
    ids=["a small share", "far ahead", "within reach", "none believable", "none"],
)
def test_answers_that_are_hopelessly_behind_are_not_registered(evidence, kept):
    assert hopeful(evidence, _VERIFY) == kept


def test_what_holds_a_pose_is_examined_where_it_is_in_doubt(sides):
    alone = register_best(*sides, [Candidate(_near(_TRUTH), 0)], _VERIFY, _FINE, _REFINE, 1)
    assert alone.assessments[0].testimony.held_by > _VERIFY.firmly_held_by
    assert alone.assessments[0].hold is None
    alike = [*HALL[:6], *box((4.0, 3.0, 0.0), (5.0, 4.0, 4.0)), *box((-5.0, -4.0, 0.0), (-4.0, -3.0, 4.0))]
    both = [_side(scan(name, pose, alike, seed=seed)) for seed, (name, pose) in enumerate(_PLACES)]
    candidates = [Candidate(_near(pose), index) for index, pose in enumerate((_TRUTH, _HALF_TURN))]
    best = register_best(*both, candidates, _VERIFY, _FINE, _REFINE, 1).assessments[0]
    assert best.testimony.held_by > _VERIFY.firmly_held_by
    assert best.hold.pushed_off_m < 1e-3


def test_where_gicp_ends_is_fitted_to_planes(sides, monkeypatch):
    elsewhere = _near(_TRUTH, (0.004, 0.0, 0.0), 0.0)
    information = np.diag([1e8] * 3 + [1e6] * 3)
    monkeypatch.setattr(fine, "fit_planes", lambda *_: PlaneFit(elsewhere, information))
    result = register_best(*sides, [Candidate(_near(_TRUTH), 0)], _VERIFY, _FINE, _REFINE, 1)
    assert result.T_target_source is elsewhere
    assert result.assessments[0].T_target_source is elsewhere
    assert result.information is information


def test_without_the_fit_the_pose_is_gicps_and_has_no_information(sides, monkeypatch):
    monkeypatch.setattr(fine, "fit_planes", pytest.fail)
    result = register_best(*sides, [Candidate(_near(_TRUTH), 0)], _VERIFY, _FINE, _REFINE, 1, fit=False)
    _assert_true(result.T_target_source)
    assert result.information is None
    assert result.evidence > _VERIFY.min_evidence


def test_of_answers_that_creep_on_only_those_that_may_win_go_on(sides, monkeypatch):
    drafting = [replace(side, drafting=_FINE.model_copy(update={"max_iterations": 1})) for side in sides]
    went_on = []

    def watched(target, source, pose, gicp, threads):
        if gicp.max_iterations == _FINE.max_iterations:
            went_on.append(pose.distance_to(_TRUTH)[1] < 0.1)
        return register(target, source, pose, gicp, threads)

    monkeypatch.setattr(fine, "register", watched)
    candidates = [
        Candidate(_near(pose, yaw_rad=0.05), index, "", 1.0) for index, pose in enumerate((_HALF_TURN, _TRUTH))
    ]
    result = register_best(*drafting, candidates, _VERIFY, _FINE, _REFINE, 1)
    _assert_true(result.T_target_source)
    assert len(went_on) >= 2
    assert all(went_on)


@pytest.mark.parametrize(
    ("sigma_m", "sigma_deg", "examined"), [(0.009, 0.09, False), (0.011, 0.0, True), (0.0, 0.11, True)]
)
def test_what_holds_an_unsure_pose_is_examined(sides, monkeypatch, sigma_m, sigma_deg, examined):
    monkeypatch.setattr(fine, "weakest_sigmas", lambda _: (sigma_m, np.deg2rad(sigma_deg)))
    result = register_best(*sides, [Candidate(_near(_TRUTH), 0)], _VERIFY, _FINE, _REFINE, 1)
    assert (result.assessments[0].hold is not None) is examined


def test_fewer_points_are_asked_only_where_there_are_many(sides):
    examined = _VERIFY.model_copy(update={"firmly_held_by": 1e9})
    off_m = []
    for most in (1_000_000, 1500):
        drafting = _FINE.model_copy(update={"max_points": most})
        drafted = [replace(side, drafting=drafting) for side in sides]
        best = register_best(*drafted, [Candidate(_near(_TRUTH), 0)], examined, _FINE, _REFINE, 1).assessments[0]
        off_m.append(best.hold.thinned_off_m)
    assert off_m[0] < 1e-9
    assert 1e-6 < off_m[1] < 0.05


def test_a_registration_that_stopped_short_is_taken_to_where_it_is_held(sides, monkeypatch):
    def stopping_short(target, source, start, *rest):
        monkeypatch.setattr(fine, "register", register)
        registered = register(target, source, start, *rest)
        pose = registered.T_target_source
        short = RigidTransform.from_rotation_translation("t", "s", pose.rotation, np.add(pose.xyz_m, [0.03, 0.0, 0.0]))
        return replace(registered, T_target_source=short)

    monkeypatch.setattr(fine, "register", stopping_short)
    examined = _VERIFY.model_copy(update={"firmly_held_by": 1e9})
    result = register_best(*sides, [Candidate(_near(_TRUTH), 3)], examined, _FINE, _REFINE, 1)
    _assert_true(result.T_target_source)
    (best,) = result.assessments
    assert best.T_target_source is result.T_target_source
    assert best.hypothesis == 3
    assert best.hold.pushed_off_m < 1e-3


@pytest.fixture(scope="module")
def corridor():
    """Two sensors in a long corridor, where one locker is all that holds a pose along it."""
    objects = [*box((-60.0, -2.0, 0.0), (60.0, 2.0, 3.0)), *box((3.0, 1.2, 0.0), (4.5, 2.0, 3.0))]
    return tuple(_side(scan(name, pose, objects, seed=seed)) for seed, (name, pose) in enumerate(_PLACES))


@pytest.mark.parametrize("along_m", [-3.0, -2.3])
def test_a_pose_that_slides_is_looked_for_along_the_slide(corridor, along_m):
    start = _TARGET.inverse() @ RigidTransform.from_xyz_rpy("world", "world", [along_m, 0, 0], [0, 0, 0]) @ _SOURCE
    best, *others = register_best(*corridor, [Candidate(start, 4, "cliques")], _VERIFY, _FINE, _REFINE, 1).assessments
    _assert_true(best.T_target_source)
    assert best.hold.pushed_off_m < _VERIFY.max_pushed_off_m
    assert best.hypothesis == 4
    assert all(other.evidence < best.evidence for other in others)
    nowhere_else = _VERIFY.model_copy(update={"slides": 0})
    (stuck,) = register_best(*corridor, [Candidate(start, 4)], nowhere_else, _FINE, _REFINE, 1).assessments
    assert stuck.T_target_source.distance_to(_TRUTH)[0] > 1.0
    assert stuck.hold.pushed_off_m > _VERIFY.max_pushed_off_m


def test_without_witnesses_the_first_candidate_is_taken_as_the_paper_does(clouds):
    sides = [_side(cloud, verified=False) for cloud in clouds]
    candidates = [Candidate(_near(_TRUTH), 3), Candidate(_near(_HALF_TURN), 0)]
    right, wrong = (
        register_best(*sides, order, _VERIFY, _FINE, _REFINE, 1) for order in (candidates, candidates[::-1])
    )
    _assert_true(right.T_target_source)
    assert (right.hypothesis, wrong.hypothesis) == (3, 0)
    assert wrong.T_target_source.distance_to(_TRUTH)[1] > 1.0
    assert right.assessments == wrong.assessments == ()
    assert right.evidence == right.fitness > wrong.fitness
