# SPDX-License-Identifier: Apache-2.0
"""A road between two rails, with a car as the only thing across it."""

import numpy as np
import pytest

from multilica.acceptance.placement import are_contradicted, held_by_movable, place
from multilica.config import AcceptanceConfig, FineConfig, RefineConfig
from multilica.geometry import RigidTransform
from multilica.registration import fixed_pair
from multilica.registration.fixed_pair import PartlyFixedCloud, without_movable
from multilica.registration.gicp import prepare_gicp_cloud, register
from multilica.registration.plane_fit import fit_planes
from multilica.registration.sensor_biases import prior_sigmas
from multilica.results import PairRegistration
from multilica.results.registrations import weakest_deviations
from multilica.stages.refine import refine

_SIGMAS = np.tile(prior_sigmas("", RefineConfig()), 2)
_HERE = RigidTransform.identity("t", "s")
_CONFIG = AcceptanceConfig()


def _face(rng, axis, at_m, lowest_m, highest_m, count):
    points_m = rng.uniform(lowest_m, highest_m, (count, 3))
    points_m[:, axis] = rng.normal(at_m, 0.01, count)
    return points_m


def _road(name, seed, *, crossed, moved_m=0.0, posts=False):
    """The cloud of a LiDAR 2 m above a road along x, perhaps with a house across or posts; the car may have moved."""
    rng = np.random.default_rng(seed)
    fixed = [
        _face(rng, 2, -2.0, (-15.0, -6.0, 0.0), (15.0, 6.0, 0.0), 6000),
        *(_face(rng, 1, y, (-15.0, 0.0, -2.0), (15.0, 0.0, -0.5), 3000) for y in (-6.0, 6.0)),
    ]
    if crossed:
        fixed.append(_face(rng, 0, 15.0, (0.0, -6.0, -2.0), (0.0, 6.0, 2.0), 3000))
    if posts:
        at_m = np.arange(-14.0, 14.5, 2.0)
        fixed += [_face(rng, 0, x, (0.0, y, -2.0), (0.0, y + 0.5, 0.0), 60) for x in at_m for y in (-6.0, 5.5)]
    car = [
        *(_face(rng, 0, x, (0.0, 2.0, -1.8), (0.0, 3.8, -0.5), 400) for x in (5.0, 9.4)),
        *(_face(rng, 1, y, (5.0, 0.0, -1.8), (9.4, 0.0, -0.5), 600) for y in (2.0, 3.8)),
    ]
    car = [points_m + np.array([moved_m, 0.0, 0.0]) for points_m in car]
    return prepare_gicp_cloud(name, np.concatenate([*fixed, *car]), FineConfig())


def _on_car(_lidar, points_m):
    x_m, y_m, z_m = points_m.T
    return (np.abs(x_m - 7.2) < 2.5) & (np.abs(y_m - 2.9) < 1.2) & (z_m > -1.85)


def _partly_fixed(*clouds, on_movable=_on_car):
    return tuple(PartlyFixedCloud(each, ~on_movable(each.name, each.points_m), FineConfig()) for each in clouds)


def _registered(*, crossed):
    target, source = (_road(name, seed, crossed=crossed) for name, seed in (("t", 1), ("s", 2)))
    fit = fit_planes(target, source, _HERE, _SIGMAS)
    known = {"information": fit.information, "bias_information": fit.biases}
    return PairRegistration("t", "s", fit.pose, 1.0, 0.0, 100, None, 1, "made", **known), (target, source)


def _fixed_pair(*, crossed):
    """The pair by all points, and by those on fixed objects."""
    pair, clouds = _registered(crossed=crossed)
    return pair, without_movable(pair, _partly_fixed(*clouds), _SIGMAS)


@pytest.fixture
def points_per_start(monkeypatch):
    """The number of source points of each registration by GICP."""
    points = []

    def counted(target, source, *rest):
        points.append(len(source.points_m))
        return register(target, source, *rest)

    monkeypatch.setattr("multilica.registration.fixed_pair.register", counted)
    return points


def _covariance(pair):
    return np.linalg.pinv(pair.information, hermitian=True)


@pytest.mark.slow
def test_a_pose_that_only_a_car_holds_may_be_off_as_far_as_it():
    pair, fixed = _fixed_pair(crossed=False)
    assert weakest_deviations(_covariance(pair))[0] < _CONFIG.max_sigma_m
    sigmas_m = np.sqrt(np.diag(_covariance(fixed))[3:])
    assert sigmas_m[0] > 1.5
    assert np.all(sigmas_m[1:] < _CONFIG.max_sigma_m)
    reason = held_by_movable(_covariance(pair), _covariance(fixed), _CONFIG)
    assert reason.code == "held_by_movable"
    assert "one frame" in reason.text
    known = held_by_movable(_covariance(pair), _covariance(fixed), _CONFIG, moved=True)
    assert known.text.startswith("objects that moved hold ")
    assert "one frame" not in known.text
    placement = place(fixed.T_target_source, _covariance(fixed), _CONFIG, held=reason)
    assert placement.uncertain
    assert placement.held_by_movable
    assert placement.reason == reason.text


@pytest.mark.slow
def test_the_joint_estimate_is_as_uncertain_at_the_same_pose():
    _, fixed = _fixed_pair(crossed=False)
    rig = refine("t", {"t": RigidTransform.identity("t", "t"), "s": fixed.T_target_source}, [fixed], RefineConfig())
    sigmas = np.sqrt(np.diag(rig.covariances["s"]))
    assert sigmas[3] > 1.5
    assert np.all(np.abs(rig.poses["s"].offset_from(fixed.T_target_source)) < 0.01 * sigmas)


@pytest.mark.slow
def test_a_wall_across_the_road_holds_the_pose():
    _, fixed = _fixed_pair(crossed=True)
    assert weakest_deviations(_covariance(fixed))[0] < _CONFIG.max_sigma_m
    assert np.linalg.norm(fixed.T_target_source.xyz_m) < 0.005


@pytest.mark.slow
def test_a_car_that_moved_does_not_choose_the_pose():
    target, source = _road("t", 1, crossed=True), _road("s", 2, crossed=True, moved_m=0.1)
    followed = RigidTransform.from_rotation_translation("t", "s", np.eye(3), np.array([-0.1, 0.0, 0.0]))
    fit = fit_planes(target, source, followed, _SIGMAS)
    pair = PairRegistration("t", "s", followed, 1.0, 0.0, 100, None, 1, "made", information=fit.information)
    fixed = without_movable(pair, _partly_fixed(target, source), _SIGMAS)
    assert np.linalg.norm(fixed.T_target_source.xyz_m) < 0.005


@pytest.mark.slow
def test_posts_that_repeat_hold_no_pose_that_a_car_chose(points_per_start):
    """The car went as far as from post to post: at the pose that follows it, all but the house fits."""
    target, source = _road("t", 1, crossed=True, posts=True), _road("s", 2, crossed=True, moved_m=2.0, posts=True)
    followed = RigidTransform.from_rotation_translation("t", "s", np.eye(3), np.array([-2.0, 0.0, 0.0]))
    fit = fit_planes(target, source, followed, _SIGMAS)
    pair = PairRegistration("t", "s", followed, 1.0, 0.0, 100, None, 1, "made", information=fit.information)

    def on_movable(lidar, points_m):
        return _on_car(lidar, points_m - [2.0 * (lidar == "s"), 0.0, 0.0])

    clouds = _partly_fixed(target, source, on_movable=on_movable)
    fixed = without_movable(pair, clouds, _SIGMAS)
    assert np.sqrt(_covariance(fixed)[3, 3]) > 1.0
    assert np.all(np.sqrt(np.diag(_covariance(fixed))[4:]) < 0.1)
    assert points_per_start[0] > 4000 >= max(points_per_start[1:])


@pytest.mark.slow
def test_a_pose_that_is_free_anyway_is_registered_once(points_per_start):
    _fixed_pair(crossed=False)
    assert len(points_per_start) == 1


@pytest.mark.slow
def test_a_pose_that_fixed_objects_mostly_hold_is_only_fitted(points_per_start):
    pair, fixed = _fixed_pair(crossed=True)
    assert fixed is not None
    assert not points_per_start
    assert fixed.T_target_source.distance_to(pair.T_target_source)[0] < 0.005


def test_without_fixed_points_no_direction_is_held():
    pair, clouds = _registered(crossed=False)
    clouds = _partly_fixed(*clouds, on_movable=lambda _, points_m: np.ones(len(points_m), dtype=bool))
    fixed = without_movable(pair, clouds, _SIGMAS)
    assert np.sqrt(np.diag(_covariance(fixed))[3:]).min() > 3.0 / np.sqrt(3.0)


@pytest.mark.parametrize(("off_m", "expected"), [(0.0, False), (0.03, False), (0.09, True)])
def test_objects_moved_if_fixed_ones_contradict_a_pose(off_m, expected):
    covariances = {name: np.diag(np.repeat([1e-3, 0.01], 3) ** 2) for name in "ab"}
    offsets = {"a": np.zeros(6), "b": np.array([0.0, 0.0, 0.0, off_m, 0.0, 0.0])}
    assert are_contradicted(offsets, covariances) is expected


def test_without_movable_objects_nothing_changes():
    pair, clouds = _registered(crossed=True)
    clouds = _partly_fixed(*clouds, on_movable=lambda _, points_m: np.zeros(len(points_m), dtype=bool))
    assert without_movable(pair, clouds, _SIGMAS) is None


@pytest.mark.parametrize(("by_all_m", "fixed_m"), [(0.003, 0.015), (0.03, 0.035)], ids=["precise", "hardly worse"])
def test_a_pose_that_hardly_needs_the_car_is_not_held_by_it(by_all_m, fixed_m):
    by_all, fixed = (np.diag(np.repeat([1e-4, sigma_m], 3) ** 2) for sigma_m in (by_all_m, fixed_m))
    assert held_by_movable(by_all, fixed, _CONFIG) is None


@pytest.mark.slow
@pytest.mark.parametrize(("shares", "tried"), [((0.9, 0.6, 0.4), 2), ((0.6, 0.1, 0.0), 1), ((0.4, 0.3, 0.2), 0)])
def test_each_direction_that_movable_objects_hold_is_tested(monkeypatch, shares, tried):
    """Beside a car that is all that holds a pose along one direction, it may hold most of another."""
    asked = []
    directions = np.eye(6)[[3, 4, 0, 1, 2, 5]]
    monkeypatch.setattr(fixed_pair, "_movable_shares", lambda *_: (np.array([*shares, 0.0, 0.0, 0.0]), directions))
    monkeypatch.setattr(fixed_pair, "_other_end", lambda *each: asked.append(each[4]))
    _, fixed = _fixed_pair(crossed=True)
    assert [each.tolist() for each in asked] == directions[:tried].tolist()
    assert weakest_deviations(_covariance(fixed))[0] < _CONFIG.max_sigma_m
