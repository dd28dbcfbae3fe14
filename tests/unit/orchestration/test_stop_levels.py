# SPDX-License-Identifier: Apache-2.0
"""The ground on which most stops agree levels a LiDAR."""

from types import SimpleNamespace

import numpy as np
import pytest

from multilica.config import CalibrationConfig, with_overrides
from multilica.geometry import RigidTransform
from multilica.orchestration import stop_views
from multilica.orchestration.pairs import PreparedLidar
from multilica.orchestration.stop_views import BodyCells, DriveStop, levels_of, prepare_views
from multilica.results import FeatureCloud, PreprocessedCloud
from multilica.stages.ground import estimate_level_about_z


def _level(roll_deg=0.0, height_m=1.5):
    return RigidTransform.from_xyz_rpy("level", "front", (0.0, 0.0, height_m), (np.deg2rad(roll_deg), 0.0, 0.0))


@pytest.fixture
def found(monkeypatch):
    """Return the level of a LiDAR out of those of its stops; None for a stop without ground."""

    def of(*levels, about_others=None):
        left, others = iter(levels), iter(about_others or [[] for _ in levels])
        monkeypatch.setattr(stop_views, "estimate_level_about_z", lambda *_: next(left))
        monkeypatch.setattr(stop_views, "find_levels", lambda *_: next(others))
        cloud = SimpleNamespace(cloud=SimpleNamespace(points_m=np.zeros((1, 3))))
        stops = [DriveStop(f"stop {number}", {"front": cloud}, ()) for number, _ in enumerate(levels, 1)]
        return levels_of(stops, CalibrationConfig()).get("front")

    return of


def test_most_stops_decide(found):
    wall, road, also_road = _level(9.0, 2.1), _level(0.5), _level(1.0, 1.55)
    assert found(wall, road, also_road) is road


@pytest.mark.parametrize("other", [_level(4.0), _level(0.0, 1.9), None], ids=["slope", "height", "no ground"])
def test_stops_that_disagree_tell_none(found, other):
    assert found(_level(), other) is None


_ROAD, _WALL, _CEILING = _level(90.0), _level(0.0), _level(-90.0)


@pytest.mark.parametrize(
    ("about_others", "is_road"),
    [
        ([[_ROAD, _WALL], [_ROAD], [_level(91.0)]], True),
        ([[_ROAD, _WALL], [_ROAD, _WALL], [_ROAD]], True),
        ([[_ROAD, _WALL], [_ROAD, _WALL], []], False),
        ([[_ROAD, _CEILING], [_ROAD, _CEILING], [_ROAD]], False),
        ([[_ROAD, _CEILING], [_ROAD], [_ROAD]], True),
        ([[_ROAD], [_WALL], []], False),
    ],
)
def test_another_axis_may_be_up(found, about_others, is_road):
    assert (found(None, _WALL, None, about_others=about_others) is _ROAD) == is_road
    assert is_road or found(None, _WALL, None, about_others=about_others) is None


def test_little_ground_is_none():
    """A strip of ground 12 m away is a plane, but no ground near the vehicle."""
    rng = np.random.default_rng(1)
    near_m, far_m = (np.column_stack([rng.uniform(x, x + 20.0, 4000), rng.uniform(-9.0, 9.0, 4000)]) for x in (3, 12))
    for flat_m, is_ground in ((near_m, True), (far_m, False)):
        cloud = {"front": np.column_stack([flat_m, np.full(4000, -1.5) + rng.normal(0.0, 0.01, 4000)])}
        level = estimate_level_about_z("front", cloud, {}, CalibrationConfig(), 10.0)
        assert (level is not None) == is_ground
        assert estimate_level_about_z("front", cloud, {}, CalibrationConfig()) is not None


@pytest.mark.parametrize("rpy_rad", [(0.0, 0.0, 0.0), (np.pi, 0.0, 0.0), (0.0, -0.5 * np.pi, 0.0)])
@pytest.mark.parametrize("has_ground", [True, False])
def test_the_ground_is_no_part_of_the_vehicle(rpy_rad, has_ground):
    """It is in the same place at every stop as well, whichever axis is up."""
    rng = np.random.default_rng(2)
    ground_m = np.column_stack([rng.uniform(-12.0, 12.0, (40_000, 2)), np.full(40_000, -1.5)])
    bonnet_m = rng.uniform([1.0, -0.5, -0.7], [2.0, 0.5, -0.65], (400, 3))
    T_lidar_level = RigidTransform.from_xyz_rpy("front", "level", (0.0, 0.0, 0.0), rpy_rad)
    empty = FeatureCloud("front", np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 33)))
    stops = []
    for name in ("stop 1", "stop 2"):
        around_m = rng.uniform([-9.0, -9.0, -1.0], [9.0, 9.0, 3.0], (2_000, 3))
        seen_m = np.concatenate([ground_m, bonnet_m, around_m] if has_ground else [bonnet_m, around_m])
        cloud = PreprocessedCloud("front", np.empty((0, 3), np.float32), T_lidar_level.apply(seen_m))
        stops.append(DriveStop(name, {"front": PreparedLidar(cloud, empty, None, CalibrationConfig())}, ()))
    for view in prepare_views(stops, {}, CalibrationConfig()).values():
        left_m = T_lidar_level.inverse().apply(view.cloud.points_m)
        on_bonnet = np.all((left_m > [1.0, -0.5, -0.7]) & (left_m < [2.0, 0.5, -0.65]), axis=1)
        assert on_bonnet.sum() == (0 if has_ground else 400)
        assert np.sum(left_m[:, 2] < -1.4) == (len(ground_m) if has_ground else 0)


def test_the_body_lies_on_no_plane_that_may_be_the_ground(monkeypatch):
    asked = []
    monkeypatch.setattr(stop_views, "find_levels", lambda *_: [_ROAD, _CEILING])
    monkeypatch.setattr(stop_views, "find_own_body", lambda _, rotations: asked.extend(rotations) or BodyCells.none())
    empty = FeatureCloud("front", np.empty((0, 3)), np.empty((0, 3)), np.empty((0, 33)))
    cloud = PreprocessedCloud("front", np.empty((0, 3), np.float32), np.ones((9, 3)))
    stops = [DriveStop("stop 1", {"front": PreparedLidar(cloud, empty, None, CalibrationConfig())}, ())]
    prepare_views(stops, {}, CalibrationConfig())
    assert [rotation.tolist() for rotation in asked] == [_ROAD.rotation.tolist(), _CEILING.rotation.tolist()]


def test_each_view_has_the_sigmas_of_all_lidars():
    """A registration takes those of its source from the configuration of its target."""
    stops = [DriveStop(name, dict.fromkeys(["front", "rear"]), ()) for name in ("stop 1", "stop 2")]
    config = with_overrides(CalibrationConfig(), ["refine.range_bias_sigmas_m.rear=0.05"])
    sigmas_m = stop_views._limits(stops, config).refine.range_bias_sigmas_m
    assert sigmas_m == dict.fromkeys(["rear", "rear at stop 1", "rear at stop 2"], 0.05)
