# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from multilica.config import FeaturesConfig
from multilica.results import PreprocessedCloud
from multilica.stages.features import compute_features

_ROOM_HALF_M = np.array([6.0, 4.0, 2.0])
_SHIFT = np.array([0.1, 0.2, 0.05])


def _room(seed=0, count=20_000):
    """The six walls of a room around the sensor, which stands off its middle."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (count, 3))
    axis = rng.integers(0, 3, count)
    points[np.arange(count), axis] = np.sign(points[np.arange(count), axis])
    return points * _ROOM_HALF_M + [1.0, -0.5, 0.3]


def _cloud(points_m):
    return PreprocessedCloud("top", points_m, points_m)


def test_normals_are_those_of_the_walls_and_look_at_the_sensor():
    features = compute_features(_cloud(_room()), FeaturesConfig())
    assert np.allclose(np.linalg.norm(features.normals, axis=1), 1.0)
    assert np.all(np.einsum("ij,ij->i", features.normals, features.points_m) <= 1e-9)
    assert np.mean(np.abs(features.normals).max(axis=1) > 0.99) > 0.7


def test_without_orientation_normals_look_anywhere():
    features = compute_features(_cloud(_room()), FeaturesConfig(orient_normals=False))
    towards = np.einsum("ij,ij->i", features.normals, features.points_m) < 0
    assert 0.1 < towards.mean() < 0.9


def test_points_beyond_the_range_are_left_out():
    far = _room() * [10.0, 1.0, 1.0]
    features = compute_features(_cloud(far), FeaturesConfig(max_range_m=20.0, voxel_size_m=0.5))
    assert np.linalg.norm(features.points_m, axis=1).max() <= 20.0
    assert features.descriptors.shape == (len(features.points_m), 33)
    cells = np.floor(features.points_m / 0.5)
    assert len(np.unique(cells, axis=0)) == len(cells)


def test_descriptors_do_not_depend_on_where_the_sensor_points():
    every_point = FeaturesConfig(voxel_size_m=1e-3, normal_radius_voxels=700.0, feature_radius_voxels=1750.0)
    turn = Rotation.random(random_state=0).as_matrix()
    straight = compute_features(_cloud(_room(count=3000)), every_point)
    turned = compute_features(_cloud(_room(count=3000) @ turn.T), every_point)
    _, same = cKDTree(turned.points_m).query(straight.points_m @ turn.T, distance_upper_bound=1e-6)
    difference = np.abs(straight.descriptors - turned.descriptors[same]).max(axis=1)
    spread = np.abs(straight.descriptors - np.roll(straight.descriptors, 1, axis=0)).max(axis=1)
    assert np.median(difference) < 0.01
    assert np.mean(difference < 1.0) > 0.9
    assert np.median(spread) > 10.0


def test_the_same_cloud_gives_the_same_bits():
    first, second = (compute_features(_cloud(_room()), FeaturesConfig()) for _ in range(2))
    assert first.descriptors.tobytes() == second.descriptors.tobytes()


@pytest.mark.parametrize("count", [0, 1, 2])
def test_next_to_no_points_are_no_crash(count):
    features = compute_features(_cloud(_room()[:count]), FeaturesConfig())
    assert len(features.points_m) == len(features.normals) == len(features.descriptors) <= count


def test_a_box_keeps_its_corners_and_a_ball_does_not():
    points = np.array([[9.0, 9.0, 9.0], [9.0, 0.0, 0.0], [-11.0, 0.0, 0.0], [0.0, -9.0, 9.0]])
    kept = {
        shape: compute_features(_cloud(points), FeaturesConfig(max_range_m=10.0, range_shape=shape)).points_m
        for shape in ("ball", "box")
    }
    assert sorted(kept["ball"].tolist()) == [[9.0, 0.0, 0.0]]
    assert sorted(kept["box"].tolist()) == sorted(points[[0, 1, 3]].tolist())


def test_the_grid_of_the_engine_open3d_moves_with_the_cloud():
    points = _room(count=5_000)
    config = FeaturesConfig(engine="open3d", orient_normals=False)
    here, moved = (compute_features(_cloud(each), config) for each in (points, points + _SHIFT))
    assert np.allclose(np.sort(here.points_m, axis=0), np.sort(moved.points_m - _SHIFT, axis=0))
    by_tensor = [compute_features(_cloud(each), FeaturesConfig()) for each in (points, points + _SHIFT)]
    assert len({len(each.points_m) for each in by_tensor}) == 2


@pytest.mark.parametrize("engine", ["open3d_tensor", "open3d"])
def test_no_points_in_range_give_no_descriptors(engine):
    features = compute_features(_cloud(np.array([[90.0, 0.0, 0.0]])), FeaturesConfig(engine=engine))
    assert features.descriptors.shape == (0, 33)
