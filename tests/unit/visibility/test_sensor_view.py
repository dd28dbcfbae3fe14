# SPDX-License-Identifier: Apache-2.0
import pickle
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from multilica.config import AcceptanceConfig
from multilica.geometry import LEVER_ARM_M, RigidTransform
from multilica.results import BeamLabel, PreprocessedCloud
from multilica.visibility.sensor_view import (
    FINE_TOLERANCES,
    may_compete,
    prepare_sensor_view,
    score_pose,
    score_visibility,
)
from tests.unit.made_rooms import HALL, Face, Foliage, box, scan

_LIMITS = AcceptanceConfig()
_TARGET = RigidTransform.from_xyz_rpy("world", "t", [-1.0, 0.0, 1.8], [0.03, 0.1, 0.4])
_SOURCE = RigidTransform.from_xyz_rpy("world", "s", [1.0, 0.8, 1.6], [-0.1, 0.2, -1.2])
_TRUTH = _TARGET.inverse() @ _SOURCE


def _view(pose, objects, seed=0):
    return prepare_sensor_view(scan(pose.source, pose, objects, seed=seed))


def _placed(view):
    return [(RigidTransform.identity(view.lidar, view.lidar), view)]


def _score(target, source, pose=_TRUTH):
    return score_pose(target, source, pose, *FINE_TOLERANCES).visibility


@pytest.fixture(scope="module")
def target():
    return _view(_TARGET, HALL)


@pytest.fixture(scope="module")
def source():
    return _view(_SOURCE, HALL, seed=1)


def test_at_the_true_pose_all_agrees_and_nothing_violates(target, source):
    score = _score(target, source)
    counts = (score.agree, score.violate, score.occluded, score.unseen)
    assert sum(counts) == len(target.probes_m) + len(source.probes_m)
    assert score.agree > 0.6 * sum(counts)
    assert score.violate <= 2
    assert len(score.labels) == len(source.probes_m)
    assert np.count_nonzero(score.labels == BeamLabel.AGREE) <= score.agree


@pytest.mark.parametrize(
    ("xyz_m", "rpy_rad"), [((1.0, 0.0, 0.0), (0, 0, 0)), ((0, 0, 0), (0, 0, np.pi)), ((0.5, 0.5, 0.0), (0, 0, 0.3))]
)
def test_beams_contradict_a_wrong_pose(target, source, xyz_m, rpy_rad):
    wrong = RigidTransform.from_xyz_rpy("t", "t", xyz_m, rpy_rad) @ _TRUTH
    score = _score(target, source, wrong)
    assert score.contradiction > 2 * _LIMITS.min_log_odds_margin
    assert score.evidence(1.0) < 0 < _LIMITS.min_evidence < _score(target, source).evidence(1.0)


def test_swapping_the_sides_changes_no_count(target, source):
    forth, back = _score(target, source), _score(source, target, _TRUTH.inverse())
    for count in ("agree", "violate", "occluded", "unseen"):
        assert getattr(forth, count) == getattr(back, count)
    assert forth.min_information_eigenvalue == pytest.approx(back.min_information_eigenvalue, rel=0.25)


@pytest.mark.parametrize("shift_m", [0.0, 0.1, 0.4, 3.0])
@pytest.mark.parametrize("margin", [1e-3, -1e-3])
def test_a_pose_competes_if_its_evidence_is_enough(target, source, shift_m, margin):
    shifted = RigidTransform.from_xyz_rpy("t", "t", (shift_m, 0.0, 0.0), (0, 0, 0)) @ _TRUTH
    best = score_pose(target, source, _TRUTH, *FINE_TOLERANCES)
    competing = score_pose(target, source, shifted, *FINE_TOLERANCES)
    least = best.evidence - best.rough_lead_over(competing) - margin
    assert may_compete(target, source, shifted, best, least, *FINE_TOLERANCES) == (margin > 0)
    assert not may_compete(target, source, shifted, best, least + 100.0, *FINE_TOLERANCES)


def test_a_wall_near_a_dense_sensor_is_solid_despite_noise():
    """Returns every 2 cm with as much noise: the nearest ones alone make a ball, not a plane."""
    rng = np.random.default_rng(5)
    y_m, z_m = (axis.ravel() for axis in np.meshgrid(np.arange(-2.0, 2.0, 0.02), np.arange(-1.0, 1.0, 0.02)))
    wall_m = np.stack([rng.normal(8.0, 0.02, len(y_m)), y_m, z_m], axis=1)
    view = prepare_sensor_view(PreprocessedCloud("t", wall_m, wall_m))
    assert np.mean(view.solid) > 0.9
    assert np.mean(np.abs(view.normals[:, 0]) > 0.98) > 0.9


_ACROSS = {"axis": 0, "at_m": 5.0, "lo_m": (0.0, -3.0, 0.0), "hi_m": (0.0, 2.0, 3.0)}


def test_a_wall_in_space_that_beams_passed_through_violates(target):
    score = _score(target, _view(_SOURCE, [*HALL, Face(**_ACROSS)], seed=1))
    assert score.violate >= 40
    assert score.contradiction > _LIMITS.min_log_odds_margin


def test_what_may_have_come_cannot_violate(target):
    came = _view(_SOURCE, [*HALL, Face(**_ACROSS)], seed=1)
    movable = replace(came, movable=np.ones(len(came.probes_m), dtype=bool))
    of_source = [int(np.count_nonzero(_score(target, view).labels == BeamLabel.VIOLATE)) for view in (came, movable)]
    assert of_source[0] >= 40
    assert of_source[1] == 0
    assert _score(target, movable).agree == _score(target, came).agree


@pytest.mark.parametrize(
    "porous",
    [Face(**_ACROSS, gaps=0.7), Foliage((4.5, -3.0, 0.0), (6.5, 2.0, 3.0))],
    ids=["fence", "foliage"],
)
def test_porous_things_cannot_violate(target, porous):
    score = _score(target, _view(_SOURCE, [*HALL, porous], seed=1))
    assert score.contradiction < _LIMITS.min_log_odds_margin


def test_a_post_with_a_return_of_the_sensor_cannot_violate():
    posts = [*HALL]
    for x_m in (-9.0, -4.0, 2.0, 7.0, 9.0):
        posts += box((x_m, -4.2, 0.0), (x_m + 0.1, -4.1, 4.0)) + box((x_m, 5.2, 0.0), (x_m + 0.1, 5.3, 4.0))
    target, source = _view(_TARGET, posts), _view(_SOURCE, posts, seed=1)
    assert _score(target, source).violate == 0
    nowhere = cKDTree(np.full((1, 3), 1e3))
    assert _score(replace(target, returns=nowhere), replace(source, returns=nowhere)).violate > 3


def test_things_between_two_beams_cannot_violate():
    """Sixteen rings, 4.7 degrees apart: a beam across the hall at 11 m can stand between two of them."""
    beam = [*HALL, *box((10.0, -6.5, 2.55), (10.2, 6.5, 2.85))]
    sparse = prepare_sensor_view(scan("t", _TARGET, beam, rings=16))
    source = _view(_SOURCE, beam, seed=1)
    assert _score(sparse, source).violate == 0
    closed = replace(sparse, image=replace(sparse.image, gap_rad=np.zeros_like(sparse.image.gap_rad)))
    assert _score(closed, source).violate > 10
    near = [*HALL, Face(axis=0, at_m=2.5, lo_m=(0.0, -2.0, 0.0), hi_m=(0.0, 1.0, 3.0))]
    assert _score(sparse, _view(_SOURCE, near, seed=1)).violate > 10


@pytest.mark.parametrize(("seen_from", "violates"), [((-1.0, 0.0, 1.8), False), ((-1.0, -5.0, 1.8), True)])
def test_a_surface_at_a_grazing_angle_cannot_violate(seen_from, violates):
    """One wall along x: the first sensor looks along it, the second one looks at it."""
    pose = RigidTransform.from_xyz_rpy("world", "t", seen_from, [0.0, 0.0, 0.4])
    along = Face(axis=1, at_m=0.2, lo_m=(3.0, 0.0, 0.0), hi_m=(10.0, 0.0, 3.0))
    source_pose = RigidTransform.from_xyz_rpy("world", "s", [5.0, 5.0, 1.6], [0.0, 0.0, 0.0])
    source = _view(source_pose, [*HALL, along], seed=1)
    score = _score(_view(pose, HALL), source, pose.inverse() @ source_pose)
    assert (score.contradiction > _LIMITS.min_log_odds_margin) is violates


def test_the_weakest_direction_of_a_corridor_is_its_axis():
    corridor = box((-80.0, -2.0, 0.0), (80.0, 2.0, 3.0))
    score = _score(_view(_TARGET, corridor), _view(_SOURCE, corridor, seed=1))
    values, vectors = np.linalg.eigh(score.information)
    axis = vectors[3:, 0] / np.linalg.norm(vectors[3:, 0])
    expected = _TARGET.rotation.T @ [1.0, 0.0, 0.0]
    assert abs(axis @ expected) > np.cos(np.deg2rad(2.0))
    assert np.linalg.norm(vectors[3:, 0]) > 0.95
    assert values[0] < 0.2 * values[1]
    assert score.min_information_eigenvalue == pytest.approx(values[0])
    assert (
        score.min_information_eigenvalue
        < 0.02 * _score(_view(_TARGET, HALL), _view(_SOURCE, HALL, seed=1)).min_information_eigenvalue
    )


def test_agreement_on_the_ground_alone_is_not_distinctive():
    ground = [Face(axis=2, at_m=0.0, lo_m=(-10.0, -10.0, 0.0), hi_m=(10.0, 10.0, 0.0))]
    score = _score(_view(_TARGET, ground), _view(_SOURCE, ground, seed=1))
    assert score.agree > 500
    assert score.distinctive < 0.05 * score.agree
    assert score.min_information_eigenvalue < 0.1 * _LIMITS.min_well_constrained_eigenvalue
    assert score.evidence(1.0) < _LIMITS.min_evidence


def test_at_the_true_pose_both_see_most_of_the_structure(target, source):
    truth = _score(target, source)
    assert truth.structure_agree > 200
    assert truth.shared_share > 0.8
    elsewhere = RigidTransform.from_xyz_rpy("t", "t", [3.0, 1.0, 0.0], [0.0, 0.0, 0.0]) @ _TRUTH
    assert _score(target, source, elsewhere).shared_share < 0.6


def test_the_slide_direction_of_a_corridor_is_its_axis():
    corridor = box((-80.0, -2.0, 0.0), (80.0, 2.0, 3.0))
    score = _score(_view(_TARGET, corridor), _view(_SOURCE, corridor, seed=1))
    assert abs(score.slide_direction @ (_TARGET.rotation.T @ [1.0, 0.0, 0.0])) > np.cos(np.deg2rad(3.0))


def test_information_is_the_lift_of_points_by_small_motions(target, source):
    none = np.zeros(0, dtype=bool)
    nothing = {"probes_m": np.zeros((0, 3)), "normals": np.zeros((0, 3)), "solid": none, "spanned": none}
    score = _score(replace(target, **nothing), source)
    agree = score.labels == BeamLabel.AGREE
    arms = _TRUTH.rotate(source.probes_m[agree])
    normals = _TRUTH.rotate(source.normals[agree])
    for motion in np.random.default_rng(0).normal(0, 1e-5, (5, 6)):
        moved = RigidTransform.from_xyz_rpy("t", "t", motion[3:], motion[:3])
        lifted_m = np.einsum("ij,ij->i", moved.apply(arms) - arms, normals)
        scaled = motion * np.repeat([LEVER_ARM_M, 1.0], 3)
        assert scaled @ score.information @ scaled == pytest.approx(np.sum(lifted_m**2), rel=0.01)


def test_normals_of_agreeing_points_are_in_the_target_frame(target, source):
    score = _score(target, source)
    labels = np.concatenate([score.labels, score.target_labels])
    normals = np.concatenate([_TRUTH.rotate(source.normals), target.normals])
    spanned = np.concatenate([source.spanned, target.spanned])
    assert score.agreeing.tolist() == np.flatnonzero((labels == BeamLabel.AGREE) & spanned).tolist()
    assert score.agreeing_normals == pytest.approx(normals[score.agreeing], abs=1e-3)


def test_a_pickled_view_scores_the_same(target, source):
    copies = pickle.loads(pickle.dumps((target, source)))  # noqa: S301 - made here
    assert _score(*copies).evidence(1.0) == _score(target, source).evidence(1.0)


def test_the_score_of_a_group_sums_those_of_its_members(target, source):
    third_pose = RigidTransform.from_xyz_rpy("world", "u", [0.0, -1.5, 1.5], [0.0, 0.0, 2.0])
    third = _view(third_pose, HALL, seed=2)
    T_t_u = _TARGET.inverse() @ third_pose
    group = [*_placed(target), (T_t_u, third)]
    together = score_visibility(group, _placed(source), _TRUTH, 0.08, 0.2)
    apart = [_score(target, source), _score(third, source, third_pose.inverse() @ _SOURCE)]
    assert together.agree == sum(each.agree for each in apart)
    assert together.violate == sum(each.violate for each in apart)
    assert together.unseen == sum(each.unseen for each in apart)
    assert np.array_equal(together.labels, apart[0].labels)
    assert together.min_information_eigenvalue > apart[0].min_information_eigenvalue


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_sensor_with_few_returns_proves_nothing(target, count):
    points_m = np.eye(3)[:count] * 5.0
    blind = prepare_sensor_view(PreprocessedCloud("s", points_m, points_m))
    score = _score(target, blind)
    assert blind.image is None
    assert len(blind.probes_m) == count
    assert score.unseen >= len(target.probes_m)
    assert score.violate == 0


def test_points_beyond_the_range_are_not_labelled(monkeypatch):
    monkeypatch.setattr("multilica.visibility.sensor_view._MAX_RANGE_M", 5.0)
    near = prepare_sensor_view(scan("t", _TARGET, HALL))
    assert 0 < np.linalg.norm(near.probes_m, axis=1).max() <= 5.5
