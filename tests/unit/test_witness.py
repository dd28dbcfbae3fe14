# SPDX-License-Identifier: Apache-2.0
from dataclasses import replace

import numpy as np
import pytest

from multilica.config import VerifyConfig
from multilica.geometry import RigidTransform
from multilica.results import PreprocessedCloud
from multilica.stages.beam_image import BeamLabel
from multilica.stages.point_tree import PointTree
from multilica.stages.witness import judge, prepare_witness
from multilica.testimony import LEVER_ARM_M
from tests.unit.made_rooms import HALL, Face, Foliage, box, scan

_CONFIG = VerifyConfig()
_TARGET = RigidTransform.from_xyz_rpy("world", "t", [-1.0, 0.0, 1.8], [0.03, 0.1, 0.4])
_SOURCE = RigidTransform.from_xyz_rpy("world", "s", [1.0, 0.8, 1.6], [-0.1, 0.2, -1.2])
_TRUTH = _TARGET.inverse() @ _SOURCE


def _witness(pose, objects, seed=0):
    return prepare_witness(scan(pose.source, pose, objects, seed=seed), _CONFIG)


def _placed(witness):
    return [(RigidTransform.identity(witness.lidar, witness.lidar), witness)]


def _judge(target, source, pose=_TRUTH):
    return judge(_placed(target), _placed(source), pose, _CONFIG.final_tolerance_m, _CONFIG.final_tolerance_deg)


@pytest.fixture(scope="module")
def target():
    return _witness(_TARGET, HALL)


@pytest.fixture(scope="module")
def source():
    return _witness(_SOURCE, HALL, seed=1)


def test_at_the_true_pose_all_agrees_and_nothing_violates(target, source):
    testimony = _judge(target, source)
    counts = (testimony.agree, testimony.violate, testimony.occluded, testimony.unseen)
    assert sum(counts) == len(target.probes_m) + len(source.probes_m)
    assert testimony.agree > 0.6 * sum(counts)
    assert testimony.violate <= 2
    assert len(testimony.labels) == len(source.probes_m)
    assert np.count_nonzero(testimony.labels == BeamLabel.AGREE) <= testimony.agree


@pytest.mark.parametrize(
    ("xyz_m", "rpy_rad"), [((1.0, 0.0, 0.0), (0, 0, 0)), ((0, 0, 0), (0, 0, np.pi)), ((0.5, 0.5, 0.0), (0, 0, 0.3))]
)
def test_a_wrong_pose_is_worth_less_than_nothing(target, source, xyz_m, rpy_rad):
    wrong = RigidTransform.from_xyz_rpy("t", "t", xyz_m, rpy_rad) @ _TRUTH
    testimony = _judge(target, source, wrong)
    assert testimony.violation_share > 5 * _CONFIG.max_violation_share_firm
    assert testimony.evidence < 0 < _judge(target, source).evidence


def test_swapping_the_sides_changes_no_count(target, source):
    forth, back = _judge(target, source), _judge(source, target, _TRUTH.inverse())
    for count in ("agree", "violate", "occluded", "unseen"):
        assert getattr(forth, count) == getattr(back, count)
    assert forth.held_by == pytest.approx(back.held_by, rel=0.25)


@pytest.mark.parametrize(
    ("xyz_m", "seen_through"),
    [((4.0, 1.0, 1.6), True), ((1.0, 0.8, 1.6), False), ((30.0, 0.8, 1.6), False), ((4.0, 1.0, 0.2), False)],
    ids=["in the open", "over the own body", "behind a wall", "just above the floor"],
)
def test_no_sensor_can_be_where_beams_pass_through_all_around(target, source, xyz_m, seen_through):
    pose = _TARGET.inverse() @ RigidTransform.from_xyz_rpy("world", "s", xyz_m, [0.0, 0.0, 0.0])
    testimony = _judge(target, source, pose)
    assert (testimony.seen_through_m > 0.0) is seen_through
    assert not seen_through or testimony.evidence <= 0.0


def test_a_wall_near_a_dense_sensor_is_solid_however_noisy_its_ranges():
    """Returns every 2 cm with as much noise: the nearest ones alone make a ball, not a plane."""
    rng = np.random.default_rng(5)
    y_m, z_m = (axis.ravel() for axis in np.meshgrid(np.arange(-2.0, 2.0, 0.02), np.arange(-1.0, 1.0, 0.02)))
    wall_m = np.stack([rng.normal(8.0, 0.02, len(y_m)), y_m, z_m], axis=1)
    witness = prepare_witness(PreprocessedCloud("t", wall_m, wall_m), _CONFIG)
    assert np.mean(witness.solid) > 0.9
    assert np.mean(np.abs(witness.normals[:, 0]) > 0.98) > 0.9


_ACROSS = {"axis": 0, "at_m": 5.0, "lo_m": (0.0, -3.0, 0.0), "hi_m": (0.0, 2.0, 3.0)}


def test_a_wall_in_space_that_beams_passed_through_violates(target):
    testimony = _judge(target, _witness(_SOURCE, [*HALL, Face(**_ACROSS)], seed=1))
    assert testimony.violate >= 40
    assert testimony.violation_share > _CONFIG.max_violation_share_firm


@pytest.mark.parametrize(
    "porous",
    [Face(**_ACROSS, gaps=0.7), Foliage((4.5, -3.0, 0.0), (6.5, 2.0, 3.0))],
    ids=["fence", "foliage"],
)
def test_what_beams_pass_through_cannot_violate(target, porous):
    testimony = _judge(target, _witness(_SOURCE, [*HALL, porous], seed=1))
    assert testimony.violation_share < _CONFIG.max_violation_share


def test_a_post_between_the_beams_of_the_image_cannot_violate_where_the_sensor_has_a_return_from_it():
    posts = [*HALL]
    for x_m in (-9.0, -4.0, 2.0, 7.0, 9.0):
        posts += box((x_m, -4.2, 0.0), (x_m + 0.1, -4.1, 4.0)) + box((x_m, 5.2, 0.0), (x_m + 0.1, 5.3, 4.0))
    target, source = _witness(_TARGET, posts), _witness(_SOURCE, posts, seed=1)
    assert _judge(target, source).violate == 0
    nowhere = PointTree(np.full((1, 3), 1e3))
    assert _judge(replace(target, returns=nowhere), replace(source, returns=nowhere)).violate > 3


def test_what_is_narrower_than_the_gap_between_two_beams_cannot_violate():
    """Sixteen rings, 4.7 degrees apart: a beam across the hall at 11 m can stand between two of them."""
    beam = [*HALL, *box((10.0, -6.5, 2.55), (10.2, 6.5, 2.85))]
    sparse = prepare_witness(scan("t", _TARGET, beam, rings=16), _CONFIG)
    source = _witness(_SOURCE, beam, seed=1)
    assert _judge(sparse, source).violate == 0
    closed = replace(sparse, image=replace(sparse.image, gap_rad=np.zeros_like(sparse.image.gap_rad)))
    assert _judge(closed, source).violate > 10
    near = [*HALL, Face(axis=0, at_m=2.5, lo_m=(0.0, -2.0, 0.0), hi_m=(0.0, 1.0, 3.0))]
    assert _judge(sparse, _witness(_SOURCE, near, seed=1)).violate > 10


@pytest.mark.parametrize(("seen_from", "violates"), [((-1.0, 0.0, 1.8), False), ((-1.0, -5.0, 1.8), True)])
def test_a_surface_at_a_grazing_angle_cannot_violate(seen_from, violates):
    """One wall along x: the first sensor looks along it, the second one looks at it."""
    pose = RigidTransform.from_xyz_rpy("world", "t", seen_from, [0.0, 0.0, 0.4])
    along = Face(axis=1, at_m=0.2, lo_m=(3.0, 0.0, 0.0), hi_m=(10.0, 0.0, 3.0))
    source_pose = RigidTransform.from_xyz_rpy("world", "s", [5.0, 5.0, 1.6], [0.0, 0.0, 0.0])
    source = _witness(source_pose, [*HALL, along], seed=1)
    testimony = _judge(_witness(pose, HALL), source, pose.inverse() @ source_pose)
    assert (testimony.violation_share > _CONFIG.max_violation_share) is violates


def test_the_weakest_direction_of_a_corridor_is_its_axis():
    corridor = box((-80.0, -2.0, 0.0), (80.0, 2.0, 3.0))
    testimony = _judge(_witness(_TARGET, corridor), _witness(_SOURCE, corridor, seed=1))
    values, vectors = np.linalg.eigh(testimony.information)
    axis = vectors[3:, 0] / np.linalg.norm(vectors[3:, 0])
    expected = _TARGET.rotation.T @ [1.0, 0.0, 0.0]
    assert abs(axis @ expected) > np.cos(np.deg2rad(2.0))
    assert np.linalg.norm(vectors[3:, 0]) > 0.95
    assert values[0] < 0.2 * values[1]
    assert testimony.held_by == pytest.approx(values[0])
    assert testimony.held_by < 0.02 * _judge(_witness(_TARGET, HALL), _witness(_SOURCE, HALL, seed=1)).held_by


def test_agreement_on_the_ground_alone_is_not_distinctive():
    ground = [Face(axis=2, at_m=0.0, lo_m=(-10.0, -10.0, 0.0), hi_m=(10.0, 10.0, 0.0))]
    testimony = _judge(_witness(_TARGET, ground), _witness(_SOURCE, ground, seed=1))
    assert testimony.agree > 500
    assert testimony.distinctive < 0.05 * testimony.agree
    assert testimony.held_by < _CONFIG.rival_held_by


def test_of_the_structure_the_truth_explains_most_and_a_wrong_pose_little(target, source):
    truth = _judge(target, source)
    assert truth.structure_agree > 200
    assert truth.explained_share > 0.8
    elsewhere = RigidTransform.from_xyz_rpy("t", "t", [3.0, 1.0, 0.0], [0.0, 0.0, 0.0]) @ _TRUTH
    assert _judge(target, source, elsewhere).explained_share < 0.3
    assert truth.evidence == pytest.approx(truth.distinctive * truth.shared_share)


def test_the_easiest_shift_of_a_corridor_is_along_it():
    corridor = box((-80.0, -2.0, 0.0), (80.0, 2.0, 3.0))
    testimony = _judge(_witness(_TARGET, corridor), _witness(_SOURCE, corridor, seed=1))
    assert abs(testimony.slide_direction @ (_TARGET.rotation.T @ [1.0, 0.0, 0.0])) > np.cos(np.deg2rad(3.0))


def test_information_tells_how_far_a_small_motion_lifts_points_off_their_surfaces(target, source):
    nothing = {"probes_m": np.zeros((0, 3)), "normals": np.zeros((0, 3)), "solid": np.zeros(0, dtype=bool)}
    testimony = _judge(replace(target, **nothing), source)
    agree = testimony.labels == BeamLabel.AGREE
    arms = _TRUTH.rotate(source.probes_m[agree])
    normals = _TRUTH.rotate(source.normals[agree])
    for motion in np.random.default_rng(0).normal(0, 1e-5, (5, 6)):
        moved = RigidTransform.from_xyz_rpy("t", "t", motion[3:], motion[:3])
        lifted_m = np.einsum("ij,ij->i", moved.apply(arms) - arms, normals)
        scaled = motion * np.repeat([LEVER_ARM_M, 1.0], 3)
        assert scaled @ testimony.information @ scaled == pytest.approx(np.sum(lifted_m**2), rel=0.01)


def test_groups_testify_as_all_their_members_do(target, source):
    third_pose = RigidTransform.from_xyz_rpy("world", "u", [0.0, -1.5, 1.5], [0.0, 0.0, 2.0])
    third = _witness(third_pose, HALL, seed=2)
    T_t_u = _TARGET.inverse() @ third_pose
    group = [*_placed(target), (T_t_u, third)]
    together = judge(group, _placed(source), _TRUTH, 0.08, 0.2)
    apart = [_judge(target, source), _judge(third, source, third_pose.inverse() @ _SOURCE)]
    assert together.agree == sum(each.agree for each in apart)
    assert together.violate == sum(each.violate for each in apart)
    assert together.unseen == sum(each.unseen for each in apart)
    assert np.array_equal(together.labels, apart[0].labels)
    assert together.held_by > apart[0].held_by


@pytest.mark.parametrize("count", [0, 1, 3])
def test_a_sensor_with_next_to_no_returns_knows_nothing(target, count):
    points_m = np.eye(3)[:count] * 5.0
    blind = prepare_witness(PreprocessedCloud("s", points_m, points_m), _CONFIG)
    testimony = _judge(target, blind)
    assert blind.image is None
    assert len(blind.probes_m) == count
    assert testimony.unseen >= len(target.probes_m)
    assert testimony.violate == 0


def test_points_beyond_the_range_are_not_judged():
    near = prepare_witness(scan("t", _TARGET, HALL), _CONFIG.model_copy(update={"max_range_m": 5.0}))
    assert 0 < np.linalg.norm(near.probes_m, axis=1).max() <= 5.5
