# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from multilica.acceptance.accept import competing_poses, is_surely_ambiguous
from multilica.config import AcceptanceConfig, CalibrationConfig, FineConfig
from multilica.geometry import RigidTransform
from multilica.registration.gicp import prepare_gicp_cloud, register_narrower
from multilica.results import PRIOR, CoarseResult, Hypothesis
from multilica.stages import verify
from multilica.stages.verify import VerificationCloud, find_poses_beside, short_gicp, verify_hypotheses
from multilica.visibility.sensor_view import prepare_sensor_view
from tests.unit.made_pairs import registration
from tests.unit.made_rooms import AISLE, HALL, box, scan

_LIMITS = AcceptanceConfig()
_NEVER_FIRM = AcceptanceConfig(min_well_constrained_eigenvalue=1e9)
_GICP = short_gicp(FineConfig())
_TARGET = RigidTransform.from_xyz_rpy("world", "t", [-1.0, 0.0, 1.8], [0.03, 0.1, 0.4])
_SOURCE = RigidTransform.from_xyz_rpy("world", "s", [1.0, 0.8, 1.6], [-0.1, 0.2, -1.2])
_TRUTH = _TARGET.inverse() @ _SOURCE
_HALF_TURN = _TARGET.inverse() @ RigidTransform.from_xyz_rpy("world", "world", [0, 0, 0], [0, 0, np.pi]) @ _SOURCE


def _near(pose, xyz_m=(0.3, -0.2, 0.1), yaw_rad=0.05):
    return RigidTransform.from_xyz_rpy("t", "t", xyz_m, [0.0, 0.0, yaw_rad]) @ pose


def _prepared(objects, columns=480):
    clouds = [
        scan(name, pose, objects, seed=seed, columns=columns)
        for seed, (name, pose) in enumerate([("t", _TARGET), ("s", _SOURCE)])
    ]
    return [
        VerificationCloud(
            prepare_sensor_view(cloud),
            prepare_gicp_cloud(cloud.lidar, cloud.points_m, _GICP),
        )
        for cloud in clouds
    ]


@pytest.fixture(scope="module")
def hall():
    return _prepared(HALL)


def _verified(lidars, *poses, limits=_LIMITS, prior=None, max_repeated=0, far=False, refused=None, **changed):
    """Verify without symmetric and repeated poses and far slides, and with constants of the stage changed."""
    origins = [(pose, "test") for pose in poses] + ([] if prior is None else [(prior, PRIOR)])
    hypotheses = tuple(Hypothesis(pose, origin=origin, index=index) for index, (pose, origin) in enumerate(origins))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("multilica.visibility.plans._MAX_REPEATED", max_repeated)
        if not far:
            patch.setattr(verify, "_far_slides", lambda *_: [])
        for name, value in ({"max_symmetric_poses": 0} | changed).items():
            patch.setattr(verify, f"_{name.upper()}", value)
        config = CalibrationConfig(acceptance=limits)
        return verify_hypotheses(*lidars, CoarseResult("t", "s", hypotheses), config, refused)


def test_the_true_pose_wins_over_one_with_more_matches(hall):
    best, *others = _verified(hall, _near(_HALF_TURN), _near(_TRUTH))
    metres, radians = best.T_target_source.distance_to(_TRUTH)
    assert metres < 0.05
    assert radians < np.deg2rad(0.5)
    assert best.hypothesis == 1
    assert best.visibility.contradiction < _LIMITS.min_log_odds_margin
    assert best.weakest_curvature > 1.0
    assert best.fitness > 0.8
    assert all(other.evidence < best.evidence - _LIMITS.min_log_odds_margin for other in others)


def test_registrations_are_distinct_and_sorted_by_evidence(hall):
    shifts = [(0.3, 0, 0), (-0.3, 0, 0), (0, 0.3, 0), (6.0, 0, 0), (-6.0, 0, 0)]
    found = _verified(hall, *(_near(_TRUTH, shift) for shift in shifts), _near(_HALF_TURN))
    evidence = [scored.evidence for scored in found]
    assert evidence == sorted(evidence, reverse=True)
    assert len(found) < 6
    for one, other in combinations(found, 2):
        metres, radians = one.T_target_source.distance_to(other.T_target_source)
        assert metres > 0.3 or radians > np.deg2rad(3.0)


@pytest.mark.usefixtures("all_promising")
def test_the_pose_that_leads_all_others_is_the_first(hall, monkeypatch):
    monkeypatch.setattr(verify, "likeliest_first", lambda found: sorted(found, key=lambda each: each.evidence))
    found = _verified(hall, _near(_TRUTH), _near(_TRUTH, (6.0, 0, 0)), _near(_HALF_TURN))
    assert len(found) > 1
    assert found[0].evidence == min(each.evidence for each in found)


@pytest.fixture
def all_promising(monkeypatch):
    """Register every hypothesis, also those that beams contradict as they are."""
    monkeypatch.setattr(verify, "_COARSE_LEAD", np.inf)
    monkeypatch.setattr(verify, "_COARSE_MARGIN", np.inf)


def test_what_beams_contradict_before_gicp_is_not_registered(hall, monkeypatch):
    started = []

    def watched(target, source, pose, gicp):
        started.append(pose.distance_to(_TRUTH)[1] < 0.1)
        return register_narrower(target, source, pose, gicp)

    monkeypatch.setattr(verify, "register_narrower", watched)
    wrong = [_near(_HALF_TURN), *(_near(_TRUTH, (0, 0, 0), yaw) for yaw in (0.8, 1.6, 2.4))]
    (best,) = _verified(hall, *wrong, _near(_TRUTH))
    assert best.hypothesis == 4
    assert started
    assert all(started)


def test_the_best_hypothesis_is_registered_however_bad(hall):
    (found,) = _verified(hall, _near(_TRUTH, (0, 0, 0), 0.8), near_slide_m=0.0)
    assert found.evidence < _LIMITS.min_evidence


def test_a_search_again_registers_only_promising_hypotheses(hall):
    wrong = _near(_TRUTH, (0, 0, 0), 0.8)
    assert _verified(hall, wrong, refused=()) == ()
    (best,) = _verified(hall, wrong, _near(_TRUTH), refused=(wrong,))
    assert best.hypothesis == 1


def test_a_search_again_ends_where_it_finds_what_was_refused(hall):
    assert _verified(hall, _near(_TRUTH), refused=(_TRUTH,)) == ()


@pytest.mark.usefixtures("all_promising")
def test_a_clearly_right_pose_ends_the_search(hall):
    poses = [_near(_TRUTH), _near(_HALF_TURN), *(_near(_TRUTH, (0, 0, 0), yaw) for yaw in (0.8, 1.6, 2.4))]
    every = _verified(hall, *poses, early_stop_poses_constrained=50)
    early = _verified(hall, *poses, early_stop_poses_constrained=2)
    assert len(early) == 2 < len(every)
    assert early[0].T_target_source.matrix.tobytes() == every[0].T_target_source.matrix.tobytes()


def test_the_search_goes_on_while_no_pose_is_right(hall):
    poses = [_near(_HALF_TURN), _near(_TRUTH, (0, 0, 0), 0.8), _near(_TRUTH)]
    found = _verified(hall, *poses, early_stop_poses=2, early_stop_poses_constrained=2)
    assert found[0].T_target_source.distance_to(_TRUTH)[0] < 0.05


@pytest.mark.slow
def test_hopeless_competing_poses_are_not_registered(hall, monkeypatch):
    registered = []

    def counted(*arguments):
        registered.append(arguments)
        return register_narrower(*arguments)

    monkeypatch.setattr(verify, "register_narrower", counted)
    best = [_verified(hall, _near(_TRUTH), limits=_NEVER_FIRM)[0]]
    few = len(registered)
    monkeypatch.setattr(verify, "min_competing_evidence", lambda *_: -np.inf)
    best.append(_verified(hall, _near(_TRUTH), limits=_NEVER_FIRM)[0])
    assert len(registered) - few >= 1 + 6 > few
    assert best[0].T_target_source.matrix.tobytes() == best[1].T_target_source.matrix.tobytes()


def test_turned_poses_start_with_a_shorter_distance(hall, monkeypatch):
    started = []

    def watched(target, source, pose, gicp):
        started.append((pose.distance_to(_TRUTH)[1] > 1.0, len(gicp.max_correspondence_distances_m)))
        return register_narrower(target, source, pose, gicp)

    monkeypatch.setattr(verify, "register_narrower", watched)
    monkeypatch.setattr(verify, "min_competing_evidence", lambda *_: -np.inf)
    _verified(hall, _TRUTH, limits=_NEVER_FIRM, max_symmetric_poses=2, near_slide_m=2.0)
    every = len(_GICP.max_correspondence_distances_m)
    assert {*started} == {(False, every), (True, every - 1)}


def test_a_hypothesis_carried_away_is_tried_with_near_points(hall, monkeypatch):
    reaches_m = []

    def carried_away_by_far_points(target, source, start, gicp):
        reaches_m.append(gicp.max_correspondence_distances_m[0])
        registered = register_narrower(target, source, start, gicp)
        pose = registered.T_target_source
        away_m = np.add(pose.xyz_m, [3.0 if reaches_m[-1] > 1.0 else 0.0, 0.0, 0.0])
        carried = RigidTransform.from_rotation_translation(pose.target, pose.source, pose.rotation, away_m)
        return replace(registered, T_target_source=carried)

    monkeypatch.setattr(verify, "register_narrower", carried_away_by_far_points)
    best, *_ = _verified(hall, _near(_TRUTH), near_slide_m=0.0)
    assert best.T_target_source.distance_to(_TRUTH)[0] < 0.05
    assert reaches_m == [2.0, 0.5]


@pytest.mark.slow
def test_a_pose_that_slid_along_pillars_is_corrected():
    """Pillars repeat every 3 m; only a box beside one of them tells which is which."""
    aisle = [*box((-40.0, -3.0, 0.0), (40.0, 3.0, 3.0)), *box((3.0, 1.5, 0.0), (4.5, 2.2, 1.5))]
    for x_m in np.arange(-16.0, 17.0, 3.0):
        aisle += box((x_m, 2.8, 0.0), (x_m + 0.5, 3.0, 3.0))
        aisle += box((x_m, -3.0, 0.0), (x_m + 0.5, -2.8, 3.0))
    lidars = _prepared(aisle, columns=720)
    slid = _TARGET.inverse() @ RigidTransform.from_xyz_rpy("world", "world", [-3.0, 0, 0], [0, 0, 0]) @ _SOURCE
    best, *others = _verified(lidars, slid, limits=_NEVER_FIRM)
    assert best.T_target_source.distance_to(_TRUTH)[0] < 0.05
    assert all(other.evidence < best.evidence - _LIMITS.min_log_odds_margin for other in others)
    (stuck,) = _verified(lidars, slid, limits=_NEVER_FIRM, near_slide_m=0.0)
    assert stuck.T_target_source.distance_to(slid)[0] < 0.1


@pytest.fixture(scope="module")
def aisle():
    return _prepared(AISLE, columns=720)


@pytest.mark.slow
def test_a_pose_among_equal_pillars_has_competing_poses(aisle):
    best, *others = _verified(aisle, _near(_TRUTH), near_slide_m=0.0, max_repeated=4)
    assert competing_poses([best, *others], _LIMITS)
    assert any(other.derivation.startswith("repeated after ") for other in others)
    for other in others:
        along_m = other.T_target_source.distance_to(best.T_target_source)[0]
        assert along_m / 3.0 == pytest.approx(round(along_m / 3.0), abs=0.1)


@pytest.mark.slow
def test_far_slides_are_tested_until_one_surely_competes(aisle):
    found = _verified(aisle, _near(_TRUTH), limits=_NEVER_FIRM, near_slide_m=0.0, far=True)
    slid = [each for each in found if each.derivation]
    assert {each.derivation[:8] for each in slid} == {"slid by "}
    last = max(slid, key=_when_slid)
    assert is_surely_ambiguous(found, _LIMITS)
    assert not is_surely_ambiguous([each for each in found if each is not last], _LIMITS)
    (alone,) = _verified(aisle, _near(_TRUTH), limits=_NEVER_FIRM, near_slide_m=0.0)
    assert alone.evidence in {each.evidence for each in found}
    links = [replace(each, view=replace(each.view, at_stop=True)) for each in aisle]
    assert len(_verified(links, _near(_TRUTH), limits=_NEVER_FIRM, near_slide_m=0.0, far=True)) == 1


@pytest.mark.slow
@pytest.mark.usefixtures("all_promising")
def test_the_search_ends_where_many_poses_compete(aisle):
    slid = [_near(_TRUTH, _TARGET.rotation.T @ (along_m, 0.0, 0.0), 0.0) for along_m in (0.0, 3.0, -3.0, 6.0, -6.0)]
    every, few = (_verified(aisle, *slid, limits=_NEVER_FIRM, surely_competing=most) for most in (50, 1))
    assert is_surely_ambiguous(few, _LIMITS)
    assert len(few) < len(slid) < len(every)
    assert not any(each.derivation for each in few)


@pytest.mark.slow
def test_poses_turned_in_long_places_are_slid(aisle, monkeypatch):
    config = CalibrationConfig()
    best, near, turned = (_verified(aisle, pose, near_slide_m=0.0)[0] for pose in (_TRUTH, _near(_TRUTH), _HALF_TURN))
    monkeypatch.setattr("multilica.acceptance.accept._LONG_PLACE", 1.0)
    slid = verify._turned_slides([best, near, turned], config)
    ways_m = [each.T_target_source.distance_to(turned.T_target_source) for each in slid]
    assert max(radians for _, radians in ways_m) < 1e-6
    assert max(metres for metres, _ in ways_m) > 9.0
    assert verify._turned_slides([best, near], config) == []
    monkeypatch.setattr("multilica.acceptance.accept._LONG_PLACE", 0.0)
    assert verify._turned_slides([best, turned], config) == []
    asked = []
    monkeypatch.setattr(verify, "_turned_slides", lambda ranked, _: (asked.append(ranked), [])[1])
    _beside(aisle, led=False)
    assert len(asked) == 2


def test_poses_slide_no_farther_than_views_are_apart(aisle):
    (best,) = _verified(aisle, _near(_TRUTH), near_slide_m=0.0)
    without_end = CalibrationConfig(acceptance=_NEVER_FIRM.model_copy(update={"max_baseline_m": 1e6}))
    slid = verify._far_slides(best, without_end)
    assert max(each.T_target_source.distance_to(best.T_target_source)[0] for each in slid) == pytest.approx(80.0)


def _when_slid(found):
    """Order slides as they are tested: the nearer first, backwards before forwards."""
    metres = float(found.derivation.split()[2])
    return abs(metres), metres


def _beside(lidars, *, swapped=False, limits=_LIMITS, led=True):
    target, source = reversed(lidars) if swapped else lidars
    (best,) = _verified([target, source], _TRUTH.inverse() if swapped else _TRUTH, limits=limits, near_slide_m=0.0)
    registered = register_narrower(target.cloud, source.cloud, best.T_target_source, _GICP)
    registered = replace(registered, target=target.view.lidar, source=source.view.lidar, registrations=(best,))
    return best, find_poses_beside(*lidars, registered, CalibrationConfig(acceptance=limits), led=led)


@pytest.mark.slow
@pytest.mark.parametrize("swapped", [False, True], ids=["as matched", "in the other order"])
def test_far_poses_repeat_after_any_number_of_periods(aisle, swapped):
    best, found = _beside(aisle, swapped=swapped, limits=_NEVER_FIRM)
    far_m = np.array([each.T_target_source.distance_to(best.T_target_source)[0] for each in found])
    assert len(found) >= 4
    assert far_m.min() > 4.0
    assert far_m.max() > 9.0
    assert {(each.T_target_source.target, each.derivation[:8]) for each in found} == {("ts"[swapped], "slid by ")}
    whole = far_m[np.abs(far_m / 3.0 - np.rint(far_m / 3.0)) < 0.05]
    assert len({*np.rint(whole / 3.0)}) >= 2


@pytest.mark.slow
def test_a_pose_that_did_not_lead_is_tested_until_one_competes(aisle):
    best, found = _beside(aisle, led=False)
    ways = {each.derivation.split()[0] for each in found}
    assert sum(is_surely_ambiguous([best, each], _LIMITS) for each in found) == 1
    assert {"turned", "repeated"} & ways
    assert not {"turned", "repeated"} & {each.derivation.split()[0] for each in _beside(aisle)[1]}


@pytest.mark.slow
@pytest.mark.parametrize(("long_place", "slid"), [(0.0, False), (1.0, True)])
def test_well_constrained_poses_are_slid_in_long_places(aisle, monkeypatch, long_place, slid):
    monkeypatch.setattr("multilica.acceptance.accept._LONG_PLACE", long_place)
    _, found = _beside(aisle, limits=_LIMITS.model_copy(update={"min_well_constrained_eigenvalue": 0.0}))
    assert any(each.derivation.startswith("slid by ") for each in found) == slid


def _labels(found):
    return [scored.label for scored in found]


@pytest.mark.usefixtures("all_promising")
def test_the_prior_is_verified_like_the_others(hall):
    found = _verified(hall, _near(_HALF_TURN), prior=_near(_TRUTH))
    assert _labels(found) == ["prior", "0"]
    assert (found[0].hypothesis, found[0].origin) == (1, PRIOR)
    alone = _verified(hall, _near(_TRUTH))
    assert found[0].evidence == alone[0].evidence
    assert found[0].T_target_source.matrix.tobytes() == alone[0].T_target_source.matrix.tobytes()


def test_a_wrong_prior_loses(hall):
    found = _verified(hall, _near(_TRUTH), prior=_near(_HALF_TURN))
    assert _labels(found) == ["0", "prior"]
    assert found[0].T_target_source.distance_to(_TRUTH)[0] < 0.05


@pytest.mark.parametrize("prior", [_HALF_TURN, _TRUTH, _near(_TRUTH, (0.25, 0, 0)), _near(_TRUTH, (6.0, 0, 0))])
def test_the_prior_does_not_change_which_others_are_tested(hall, prior):
    poses = [_near(_HALF_TURN), *(_near(_TRUTH, (0, 0, 0), yaw) for yaw in (0.8, 1.6, 2.4)), _near(_TRUTH)]
    without = {one.label: one for one in _verified(hall, *poses, early_stop_poses=2)}
    found = _verified(hall, *poses, early_stop_poses=2, prior=prior)
    kept = [one for one in found if one.origin != PRIOR]
    assert {one.label for one in kept} <= set(without)
    assert all(one.evidence == without[one.label].evidence for one in kept)
    lost = [without[label] for label in set(without) - set(_labels(kept))]
    assert all(one.T_target_source.distance_to(found[0].T_target_source)[0] < 0.3 for one in lost)
    assert found[0].evidence >= max(one.evidence for one in without.values())


def test_of_two_starts_with_one_end_the_better_stays(hall):
    (solver,) = _verified(hall, _near(_TRUTH))
    (prior,) = _verified(hall, prior=_TRUTH)
    (both,) = _verified(hall, _near(_TRUTH), prior=_TRUTH)
    assert both.evidence == max(solver.evidence, prior.evidence)
    assert both.label == ("0" if solver.evidence >= prior.evidence else "prior")


def test_only_a_hopeless_pose_of_the_prior_is_turned(hall):
    """A LiDAR may be drawn the wrong way round; what a solver found is not right for being turned."""
    settings = {"limits": AcceptanceConfig(min_evidence=60.0), "max_symmetric_poses": 6, "near_slide_m": 0.0}
    (found,) = _verified(hall, _near(_HALF_TURN), **settings)
    assert found.T_target_source.distance_to(_HALF_TURN)[0] < 1.0
    best, *_ = _verified(hall, prior=_near(_HALF_TURN), **settings)
    assert best.T_target_source.distance_to(_TRUTH)[0] < 0.05


def test_the_half_turn_of_a_hall_is_tested_as_well():
    """The bare box, without what stands in it, looks the same from its other end, and upside down."""
    bare = box((-8.0, -5.0, 0.0), (8.0, 5.0, 4.0))
    best, *others = _verified(_prepared(bare), _near(_TRUTH), max_symmetric_poses=6)
    least = best.evidence - _LIMITS.min_log_odds_margin
    rivals = [each.T_target_source for each in (best, *others) if each.evidence > least]
    for expected in (_TRUTH, _HALF_TURN):
        assert min(pose.distance_to(expected)[0] for pose in rivals) < 0.1


def test_without_hypotheses_there_is_no_registration(hall):
    assert _verified(hall) == ()


def test_the_short_gicp_is_coarse_and_by_small_gicp():
    gicp = short_gicp(FineConfig(engine="open3d", neighbours=11))
    assert (gicp.engine, gicp.max_points, gicp.voxel_size_m, gicp.neighbours) == ("small_gicp", 4000, 0.5, 11)
    # It ends well within its grid, at 10 m too.
    assert 10.0 * max(gicp.translation_epsilon_m, 10.0 * gicp.rotation_epsilon_rad) < gicp.voxel_size_m
    assert list(gicp.max_correspondence_distances_m) == sorted(gicp.max_correspondence_distances_m, reverse=True)


@pytest.mark.parametrize("derivation", ["", "slid by +1 m"])
def test_a_derived_pose_at_one_of_matches_counts_as_that(derivation):
    known = replace(registration(_TRUTH), derivation=derivation)
    better = registration(_TRUTH)
    better = replace(better, derivation="turned by 180 deg", visibility=replace(better.visibility, agree=400))
    (found,) = verify._joined([known], better)
    assert found.evidence == better.evidence > known.evidence
    assert found.derivation == (derivation and better.derivation)
