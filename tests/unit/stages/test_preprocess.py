# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.config import PreprocessConfig
from multilica.snapshot import LidarScans, Scan
from multilica.stages.preprocess import preprocess


def _lidar(*frames):
    return LidarScans("top", tuple(Scan(np.asarray(points, dtype=np.float32).reshape(-1, 3)) for points in frames))


def _sphere(range_m, count=50):
    directions = np.random.default_rng(0).normal(size=(count, 3))
    return range_m * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_what_is_too_near_or_too_far_is_dropped_with_its_reason():
    cloud = preprocess(
        _lidar(np.concatenate([_sphere(0.5, 7), _sphere(20.0, 11), _sphere(150.0, 13)])), PreprocessConfig()
    )
    assert cloud.lidar == "top"
    assert len(cloud.returns_m) == 11
    assert {reason: len(points) for reason, points in cloud.dropped_m.items()} == {"too_near": 7, "too_far": 13}
    assert np.allclose(np.linalg.norm(cloud.dropped_m["too_near"], axis=1), 0.5, atol=1e-5)


def test_the_limits_themselves_are_kept():
    cloud = preprocess(_lidar([[1.0, 0.0, 0.0], [0.0, 100.0, 0.0]]), PreprocessConfig())
    assert len(cloud.returns_m) == 2
    assert cloud.dropped_m == {}


def test_points_that_are_not_finite_are_dropped():
    bad = [[np.nan, 0.0, 0.0], [np.inf, 5.0, 0.0], [0.0, 5.0, -np.inf]]
    cloud = preprocess(_lidar(np.concatenate([_sphere(5.0, 4), bad])), PreprocessConfig())
    assert len(cloud.returns_m) == 4
    assert np.all(np.isfinite(cloud.points_m))


def test_frames_are_accumulated_then_thinned():
    frames = [_sphere(10.0, 400) + np.random.default_rng(seed).normal(0, 0.002, (400, 3)) for seed in range(5)]
    cloud = preprocess(_lidar(*frames), PreprocessConfig(voxel_size_m=0.1))
    assert len(cloud.returns_m) == 2000
    assert len(cloud.points_m) < 1000
    voxels = np.floor(cloud.points_m / 0.1)
    assert len(np.unique(voxels, axis=0)) == len(voxels)


def test_without_a_voxel_size_nothing_is_thinned():
    cloud = preprocess(_lidar([[5.0, 0.0, 0.0]] * 5), PreprocessConfig(voxel_size_m=0.0))
    assert len(cloud.points_m) == 5


@pytest.mark.parametrize("frames", [(), (np.empty((0, 3)),), (_sphere(0.1),)], ids=["none", "empty", "all too near"])
def test_nothing_left_is_an_empty_cloud(frames):
    cloud = preprocess(_lidar(*frames), PreprocessConfig())
    assert cloud.points_m.shape == cloud.returns_m.shape == (0, 3)


def test_clouds_cannot_be_written_to():
    cloud = preprocess(_lidar(_sphere(5.0)), PreprocessConfig())
    for array in (cloud.points_m, cloud.returns_m):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0.0
