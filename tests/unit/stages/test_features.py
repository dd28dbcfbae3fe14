# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.config import FeaturesConfig
from multilica.registration.lazy_open3d import o3d
from multilica.results import PreprocessedCloud
from multilica.stages.features import Neighbourhoods, compute_features, compute_fpfh, estimate_normals

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


def _described(points_m, normal_radius_m, radius_m, most=100):
    """Descriptors of every point, with normals that look at the sensor."""
    around = Neighbourhoods.find(points_m, radius_m)
    normals = estimate_normals(points_m, around.within(normal_radius_m, 30))
    normals[np.einsum("ij,ij->i", normals, points_m) > 0.0] *= -1.0
    return compute_fpfh(points_m, normals, around.within(radius_m, most))


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
    turn = Rotation.random(random_state=0).as_matrix()
    points = _room(count=3000)
    straight, turned = (_described(each, 0.7, 1.75) for each in (points, points @ turn.T))
    difference = np.abs(straight - turned).max(axis=1)
    spread = np.abs(straight - np.roll(straight, 1, axis=0)).max(axis=1)
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
        for shape in ("sphere", "box")
    }
    assert sorted(kept["sphere"].tolist()) == [[9.0, 0.0, 0.0]]
    assert sorted(kept["box"].tolist()) == sorted(points[[0, 1, 3]].tolist())


def test_the_grid_of_the_engine_open3d_moves_with_the_cloud():
    points = _room(count=5_000)
    config = FeaturesConfig(engine="open3d", orient_normals=False)
    here, moved = (compute_features(_cloud(each), config) for each in (points, points + _SHIFT))
    assert np.allclose(np.sort(here.points_m, axis=0), np.sort(moved.points_m - _SHIFT, axis=0))
    by_tensor = [compute_features(_cloud(each), FeaturesConfig()) for each in (points, points + _SHIFT)]
    assert len({len(each.points_m) for each in by_tensor}) == 2


@pytest.mark.parametrize("engine", ["numpy", "open3d"])
def test_no_points_in_range_give_no_descriptors(engine):
    features = compute_features(_cloud(np.array([[90.0, 0.0, 0.0]])), FeaturesConfig(engine=engine))
    assert features.descriptors.shape == (0, 33)


def test_the_engine_open3d_gives_a_descriptor_per_point():
    features = compute_features(_cloud(_room(count=2000)), FeaturesConfig(engine="open3d"))
    assert features.descriptors.shape == (len(features.points_m), 33)
    sums = features.descriptors.reshape(-1, 3, 11).sum(axis=2)
    assert np.median(np.abs(sums - sums[0]) / sums[0]) < 1e-6


def test_normals_and_descriptors_equal_those_of_open3d():
    points = _room(count=4000)
    pcd = o3d.t.geometry.PointCloud(points)
    pcd.estimate_normals(30, 0.7)
    pcd.orient_normals_towards_camera_location(o3d.core.Tensor(np.zeros(3)))
    expected = o3d.t.pipelines.registration.compute_fpfh_feature(pcd, 100, 1.75).numpy()
    around = Neighbourhoods.find(points, 1.75)
    normals = estimate_normals(points, around.within(0.7, 30))
    assert np.abs(np.einsum("ij,ij->i", normals, pcd.point.normals.numpy())).min() > 1.0 - 1e-9
    # Where two normals are as near to the line between their points, rounding decides which one is the source.
    difference = np.abs(_described(points, 0.7, 1.75) - expected).max(axis=1)
    assert np.mean(difference < 1e-6) > 0.7
    assert np.mean(difference < 2.0) > 0.97


def test_a_crowded_point_counts_its_nearest_only():
    rng = np.random.default_rng(3)
    points = rng.normal(size=(400, 3))
    around = Neighbourhoods.find(points, 2.0).within(1.5, 20)
    for side in (0, 1):
        count = np.bincount(around.pairs[side, around.kept[side]], minlength=400)
        assert count.max() <= 19
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    nearest = [
        {other for other in order[1:20] if row[other] <= 1.5}
        for row, order in zip(distances, np.argsort(distances, axis=1), strict=True)
    ]
    found = [set() for _ in points]
    for side in (0, 1):
        for owner, other in around.pairs[[side, 1 - side]][:, around.kept[side]].T:
            found[owner].add(other)
    assert found == nearest


def test_the_order_of_the_points_does_not_matter():
    points = _room(count=1500)
    order = np.random.default_rng(1).permutation(len(points))
    assert np.allclose(_described(points, 0.7, 1.75)[order], _described(points[order], 0.7, 1.75), atol=1e-6)
