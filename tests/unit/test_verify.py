# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from multilica.config import FineConfig, VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import PRIOR, CoarseResult, Hypothesis
from multilica.stages import verify
from multilica.stages.gicp import register_narrower
from multilica.stages.registration_cloud import prepare_registration_cloud
from multilica.stages.verify import assess_hypotheses, short_gicp
from multilica.stages.witness import prepare_witness
from tests.unit.made_rooms import HALL, box, scan

_CONFIG = VerifyConfig(rivals=0)
_GICP = short_gicp(_CONFIG, FineConfig())
_TARGET = RigidTransform.from_xyz_rpy("world", "t", [-1.0, 0.0, 1.8], [0.03, 0.1, 0.4])
_SOURCE = RigidTransform.from_xyz_rpy("world", "s", [1.0, 0.8, 1.6], [-0.1, 0.2, -1.2])
_TRUTH = _TARGET.inverse() @ _SOURCE
_HALF_TURN = _TARGET.inverse() @ RigidTransform.from_xyz_rpy("world", "world", [0, 0, 0], [0, 0, np.pi]) @ _SOURCE


def _near(pose, xyz_m=(0.3, -0.2, 0.1), yaw_rad=0.05):
    return RigidTransform.from_xyz_rpy("t", "t", xyz_m, [0.0, 0.0, yaw_rad]) @ pose


@pytest.fixture(scope="module")
def sides():
    clouds = [scan("t", _TARGET, HALL), scan("s", _SOURCE, HALL, seed=1)]
    return [
        (prepare_witness(cloud, _CONFIG), prepare_registration_cloud(cloud.lidar, cloud.points_m, _GICP, 1))
        for cloud in clouds
    ]


def _assessed(sides, *poses, config=_CONFIG, prior=None):
    origins = [(pose, "test") for pose in poses] + ([] if prior is None else [(prior, PRIOR)])
    hypotheses = tuple(Hypothesis(pose, np.zeros(0, dtype=bool), 0.0, origin) for pose, origin in origins)
    return assess_hypotheses(*sides, CoarseResult("t", "s", hypotheses), config, _GICP, 1)


def test_the_true_pose_wins_over_one_with_more_matches(sides):
    best, *others = _assessed(sides, _near(_HALF_TURN), _near(_TRUTH))
    metres, radians = best.T_target_source.distance_to(_TRUTH)
    assert metres < 0.05
    assert radians < np.deg2rad(0.5)
    assert best.hypothesis == 1
    assert best.testimony.violation_share < _CONFIG.max_violation_share
    assert best.weakest_curvature > _CONFIG.min_curvature
    assert best.fitness > 0.8
    assert all(other.evidence < 0.3 * best.evidence for other in others)


def test_answers_are_distinct_and_in_the_order_of_their_evidence(sides):
    shifts = [(0.3, 0, 0), (-0.3, 0, 0), (0, 0.3, 0), (6.0, 0, 0), (-6.0, 0, 0)]
    found = _assessed(sides, *(_near(_TRUTH, shift) for shift in shifts), _near(_HALF_TURN))
    evidence = [assessment.evidence for assessment in found]
    assert evidence == sorted(evidence, reverse=True)
    assert len(found) < 6
    for one, other in combinations(found, 2):
        metres, radians = one.T_target_source.distance_to(other.T_target_source)
        assert metres > 0.3 or radians > np.deg2rad(3.0)


def test_once_an_answer_is_clearly_right_the_rest_is_left_out(sides):
    poses = [_near(_TRUTH), _near(_HALF_TURN), *(_near(_TRUTH, (0, 0, 0), yaw) for yaw in (0.8, 1.6, 2.4))]
    every = _assessed(sides, *poses, config=_CONFIG.model_copy(update={"settled_after_firm": 50}))
    early = _assessed(sides, *poses, config=_CONFIG.model_copy(update={"settled_after_firm": 2}))
    assert len(early) == 2 < len(every)
    assert early[0].T_target_source.matrix.tobytes() == every[0].T_target_source.matrix.tobytes()


def test_the_search_goes_on_while_no_answer_is_right(sides):
    poses = [_near(_HALF_TURN), _near(_TRUTH, (0, 0, 0), 0.8), _near(_TRUTH)]
    found = _assessed(sides, *poses, config=_CONFIG.model_copy(update={"settled_after": 2, "settled_after_firm": 2}))
    assert found[0].T_target_source.distance_to(_TRUTH)[0] < 0.05


def test_rivals_that_put_walls_into_empty_space_are_not_registered(sides, monkeypatch):
    tried = []

    def counted(*arguments):
        tried.append(arguments)
        return register_narrower(*arguments)

    monkeypatch.setattr(verify, "register_narrower", counted)
    loose = _CONFIG.model_copy(update={"firmly_held_by": 1e9})
    best = [_assessed(sides, _near(_TRUTH), config=loose)[0]]
    few = len(tried)
    monkeypatch.setattr(verify, "_may_win", lambda *_: True)
    best.append(_assessed(sides, _near(_TRUTH), config=loose)[0])
    assert len(tried) - few >= 1 + loose.slides > few
    assert best[0].T_target_source.matrix.tobytes() == best[1].T_target_source.matrix.tobytes()


def test_only_a_turned_rival_starts_from_the_shorter_distances(sides, monkeypatch):
    started = []

    def watched(target, source, pose, gicp, threads):
        started.append((pose.distance_to(_TRUTH)[1] > 1.0, len(gicp.max_correspondence_distances_m)))
        return register_narrower(target, source, pose, gicp, threads)

    monkeypatch.setattr(verify, "register_narrower", watched)
    monkeypatch.setattr(verify, "_may_win", lambda *_: True)
    config = _CONFIG.model_copy(update={"rivals": 2, "slides": 2, "firmly_held_by": 1e9})
    _assessed(sides, _TRUTH, config=config)
    every = len(_GICP.max_correspondence_distances_m)
    assert {*started} == {(False, every), (True, every - 1)}


def test_a_hypothesis_that_gicp_carries_off_has_a_second_try_among_near_points(sides, monkeypatch):
    reaches_m = []

    def carried_off_by_far_points(target, source, start, gicp, threads):
        reaches_m.append(gicp.max_correspondence_distances_m[0])
        registered = register_narrower(target, source, start, gicp, threads)
        pose = registered.T_target_source
        away_m = np.add(pose.xyz_m, [3.0 if reaches_m[-1] > 1.0 else 0.0, 0.0, 0.0])
        carried = RigidTransform.from_rotation_translation(pose.target, pose.source, pose.rotation, away_m)
        return replace(registered, T_target_source=carried)

    monkeypatch.setattr(verify, "register_narrower", carried_off_by_far_points)
    best, *_ = _assessed(sides, _near(_TRUTH), config=_CONFIG.model_copy(update={"rivals": 0, "slides": 0}))
    assert best.T_target_source.distance_to(_TRUTH)[0] < 0.05
    assert reaches_m == [2.0, 0.5]


def test_a_pose_that_slid_along_a_row_of_pillars_is_found_back():
    """Pillars repeat every 3 m; only a box beside one of them tells which is which."""
    aisle = [*box((-40.0, -3.0, 0.0), (40.0, 3.0, 3.0)), *box((3.0, 1.5, 0.0), (4.5, 2.2, 1.5))]
    for x_m in np.arange(-16.0, 17.0, 3.0):
        aisle += box((x_m, 2.8, 0.0), (x_m + 0.5, 3.0, 3.0))
        aisle += box((x_m, -3.0, 0.0), (x_m + 0.5, -2.8, 3.0))
    clouds = [scan("t", _TARGET, aisle), scan("s", _SOURCE, aisle, seed=1)]
    sides = [
        (prepare_witness(cloud, _CONFIG), prepare_registration_cloud(cloud.lidar, cloud.points_m, _GICP, 1))
        for cloud in clouds
    ]
    slid = _TARGET.inverse() @ RigidTransform.from_xyz_rpy("world", "world", [-3.0, 0, 0], [0, 0, 0]) @ _SOURCE
    held_loosely = _CONFIG.model_copy(update={"firmly_held_by": 1e9})
    best, *others = _assessed(sides, slid, config=held_loosely)
    assert best.T_target_source.distance_to(_TRUTH)[0] < 0.05
    assert all(other.evidence < 0.9 * best.evidence for other in others)
    (stuck,) = _assessed(sides, slid, config=held_loosely.model_copy(update={"slides": 0}))
    assert stuck.T_target_source.distance_to(slid)[0] < 0.1


def _labels(found):
    return [assessment.label for assessment in found]


def test_the_prior_is_judged_like_the_others(sides):
    found = _assessed(sides, _near(_HALF_TURN), prior=_near(_TRUTH))
    assert _labels(found) == ["prior", "0"]
    assert (found[0].hypothesis, found[0].origin) == (1, PRIOR)
    alone = _assessed(sides, _near(_TRUTH))
    assert found[0].evidence == alone[0].evidence
    assert found[0].T_target_source.matrix.tobytes() == alone[0].T_target_source.matrix.tobytes()


def test_a_wrong_prior_loses(sides):
    found = _assessed(sides, _near(_TRUTH), prior=_near(_HALF_TURN))
    assert _labels(found) == ["0", "prior"]
    assert found[0].T_target_source.distance_to(_TRUTH)[0] < 0.05


@pytest.mark.parametrize("prior", [_HALF_TURN, _TRUTH, _near(_TRUTH, (0.25, 0, 0)), _near(_TRUTH, (6.0, 0, 0))])
def test_the_prior_has_no_say_in_which_others_are_tried(sides, prior):
    poses = [_near(_HALF_TURN), *(_near(_TRUTH, (0, 0, 0), yaw) for yaw in (0.8, 1.6, 2.4)), _near(_TRUTH)]
    config = _CONFIG.model_copy(update={"settled_after": 2})
    without = {one.label: one for one in _assessed(sides, *poses, config=config)}
    found = _assessed(sides, *poses, config=config, prior=prior)
    kept = [one for one in found if one.origin != PRIOR]
    assert {one.label for one in kept} <= set(without)
    assert all(one.evidence == without[one.label].evidence for one in kept)
    lost = [without[label] for label in set(without) - set(_labels(kept))]
    assert all(one.T_target_source.distance_to(found[0].T_target_source)[0] < 0.3 for one in lost)
    assert found[0].evidence >= max(one.evidence for one in without.values())


def test_of_two_starts_with_the_same_end_the_one_with_more_evidence_stays(sides):
    (solver,) = _assessed(sides, _near(_TRUTH))
    (prior,) = _assessed(sides, prior=_TRUTH)
    (both,) = _assessed(sides, _near(_TRUTH), prior=_TRUTH)
    assert both.evidence == max(solver.evidence, prior.evidence)
    assert both.label == ("0" if solver.evidence >= prior.evidence else "prior")


def test_the_half_turn_of_a_hall_is_tried_beside_the_truth(sides):
    """The bare box, without what stands in it, looks the same from its other end."""
    bare = box((-8.0, -5.0, 0.0), (8.0, 5.0, 4.0))
    clouds = [scan("t", _TARGET, bare), scan("s", _SOURCE, bare, seed=1)]
    sides = [
        (prepare_witness(cloud, _CONFIG), prepare_registration_cloud(cloud.lidar, cloud.points_m, _GICP, 1))
        for cloud in clouds
    ]
    best, second, *_ = _assessed(sides, _near(_TRUTH), config=_CONFIG.model_copy(update={"rivals": 6}))
    poses = (best.T_target_source, second.T_target_source)
    for expected in (_TRUTH, _HALF_TURN):
        assert min(pose.distance_to(expected)[0] for pose in poses) < 0.1
    assert second.evidence > 0.9 * best.evidence


def test_without_hypotheses_there_is_no_answer(sides):
    assert _assessed(sides) == ()


def test_the_short_gicp_is_coarse_and_always_of_the_engine_that_tells_its_hessian():
    gicp = short_gicp(VerifyConfig(max_points=123, voxel_size_m=0.7), FineConfig(engine="open3d", neighbours=11))
    assert (gicp.engine, gicp.max_points, gicp.voxel_size_m, gicp.neighbours) == ("small_gicp", 123, 0.7, 11)
    assert list(gicp.max_correspondence_distances_m) == sorted(gicp.max_correspondence_distances_m, reverse=True)
