# SPDX-License-Identifier: Apache-2.0
import pickle

import numpy as np
import pytest

from multilica.config import FineConfig, preset
from multilica.geometry import RigidTransform
from multilica.registration import gicp
from multilica.registration.creep import Creep
from multilica.registration.gicp import fitness_and_rmse, prepare_gicp_cloud, register, register_narrower
from multilica.registration.lazy_open3d import o3d
from tests.unit.made_rooms import box, scan

_TRUTH = RigidTransform.from_xyz_rpy("t", "s", [0.4, -0.2, 0.1], [0.02, -0.01, 0.05])


def _room(seed, count, noise_m=0.01):
    """Points on the six walls of a room of 12 x 8 x 3 m, seen from its middle."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (count, 3))
    axis = rng.integers(0, 3, count)
    points[np.arange(count), axis] = np.sign(points[np.arange(count), axis])
    return points * [6.0, 4.0, 1.5] + rng.normal(0, noise_m, (count, 3))


def _clouds(config, counts=(20_000, 8_000)):
    target = prepare_gicp_cloud("t", _room(0, counts[0]), config)
    source = prepare_gicp_cloud("s", _TRUTH.inverse().apply(_room(1, counts[1])), config)
    return target, source


@pytest.mark.parametrize("config", [FineConfig(), preset("paper").fine], ids=["small_gicp", "open3d"])
def test_finds_the_truth(config):
    target, source = _clouds(config)
    result = register(target, source, RigidTransform.identity("t", "s"), config)
    metres, radians = result.T_target_source.distance_to(_TRUTH)
    assert metres < 0.005
    assert radians < np.deg2rad(0.1)
    assert result.fitness > 0.9
    if config.engine == "open3d":
        assert (result.converged, result.iterations, result.steps) == (None, None, ())
        return
    assert result.converged
    assert result.steps[-1].iteration == result.iterations
    assert result.steps[-1].fitness == pytest.approx(result.steps[-1].inliers / len(source.points_m))


@pytest.mark.slow
def test_epsilon_changes_the_pose_of_open3d(monkeypatch):
    config, poses = preset("paper").fine, []
    for epsilon in (gicp._OPEN3D_EPSILON, 0.5):
        monkeypatch.setattr(gicp, "_OPEN3D_EPSILON", epsilon)
        poses.append(register(*_clouds(config), RigidTransform.identity("t", "s"), config).T_target_source)
    assert poses[0].distance_to(poses[1])[0] > 1e-5


def test_it_converged_only_if_it_did_with_each_distance():
    start = RigidTransform.identity("t", "s")
    many = FineConfig(max_correspondence_distances_m=(0.5,) + (0.25,) * 20, max_iterations=2)
    result = register(*_clouds(many), start, many)
    assert result.steps[-1].iteration - result.steps[-2].iteration < 2
    assert not result.converged


@pytest.fixture
def tunnel():
    """Clouds of a tunnel where only a post at a wall holds the pose along it, and a start 0.3 m off."""
    faces = [*box((-60.0, -2.0, 0.0), (60.0, 2.0, 3.0)), *box((3.0, 1.7, 0.0), (3.5, 2.0, 3.0))]
    places = [RigidTransform.from_xyz_rpy("w", "t", [0.0, 0.0, 1.5], [0.0, 0.0, 0.0])]
    places.append(RigidTransform.from_xyz_rpy("w", "s", [1.0, 0.3, 1.5], [0.0, 0.0, 0.4]))
    config = FineConfig()
    clouds = [prepare_gicp_cloud(at.source, scan(at.source, at, faces).points_m, config) for at in places]
    return *clouds, RigidTransform.from_xyz_rpy("t", "s", [1.3, 0.3, 0.0], [0.0, 0.0, 0.4])


def test_along_a_tunnel_it_leaps_to_where_it_creeps(tunnel, monkeypatch):
    leaping = register(*tunnel, FineConfig())
    monkeypatch.setattr(Creep, "leap", lambda _self, _before, after, _longest_m: after)
    creeping = register(*tunnel, FineConfig())
    assert leaping.converged
    assert leaping.iterations < 0.75 * creeping.iterations
    assert leaping.T_target_source.distance_to(creeping.T_target_source)[0] < 1e-3


def test_iterations_follow_each_leap(tunnel, monkeypatch):
    leaps = []
    monkeypatch.setattr(Creep, "leap", lambda _self, _before, after, longest_m: leaps.append(longest_m) or after)
    result = register(*tunnel, FineConfig(max_iterations=12))
    assert not result.converged
    steps_m = [step.max_correspondence_distance_m for step in result.steps]
    assert leaps == [0.5 * steps_m[k] for k in range(len(steps_m) - 1) if steps_m[k + 1] == steps_m[k]]


def test_only_the_last_distance_has_to_converge_fully(monkeypatch):
    config, found = FineConfig(translation_epsilon_m=1e-6), []
    for looser in (gicp._LOOSER, 1.0):
        monkeypatch.setattr(gicp, "_LOOSER", looser)
        found.append(register(*_clouds(config), RigidTransform.identity("t", "s"), config))
    assert found[0].iterations < found[1].iterations
    assert found[0].T_target_source.distance_to(found[1].T_target_source)[0] < 1e-5


def test_fitness_and_rmse_are_those_of_open3d():
    target, source = _clouds(FineConfig())
    start = RigidTransform.from_xyz_rpy("t", "s", [0.3, 0.0, 0.0], [0.0, 0.0, 0.02])
    fitness, rmse_m, inliers = fitness_and_rmse(target, source, start, 0.2)
    clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud.points_m)) for cloud in (source, target)]
    expected = o3d.pipelines.registration.evaluate_registration(*clouds, 0.2, start.matrix)
    assert fitness == pytest.approx(expected.fitness, abs=2.0 / len(source.points_m))
    assert rmse_m == pytest.approx(expected.inlier_rmse, rel=1e-3)
    assert inliers == round(fitness * len(source.points_m))


def test_no_inliers_is_no_fit():
    target, source = _clouds(FineConfig(), (500, 500))
    far = RigidTransform.from_xyz_rpy("t", "s", [500.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    assert fitness_and_rmse(target, source, far, 0.2) == (0.0, float("inf"), 0)


def test_the_same_clouds_give_the_same_bits():
    runs = []
    for _ in range(2):
        target, source = _clouds(FineConfig())
        runs.append(register(target, source, RigidTransform.identity("t", "s"), FineConfig()))
    assert runs[0].T_target_source.matrix.tobytes() == runs[1].T_target_source.matrix.tobytes()


def test_pickled_clouds_give_the_same_bits():
    config = FineConfig()
    clouds, start = _clouds(config, (2000, 1000)), RigidTransform.identity("t", "s")
    copies = pickle.loads(pickle.dumps(clouds))  # noqa: S301 - made here
    poses = [register(*each, start, config).T_target_source for each in (clouds, copies)]
    assert poses[0].matrix.tobytes() == poses[1].matrix.tobytes()


def test_a_source_out_of_reach_stays_where_it_is():
    target, source = _clouds(FineConfig())
    far = RigidTransform.from_xyz_rpy("t", "s", [50.0, 0.0, 0.0], [0.0, 0.0, 0.0])
    result = register(target, source, far, FineConfig())
    assert result.T_target_source.distance_to(far)[0] < 1e-9
    assert (result.fitness, result.inliers) == (0.0, 0)


def test_covariances_are_estimated_where_they_are_used():
    """GICP takes a part of a source that reaches beyond the target: the rest needs none."""
    config, start = FineConfig(), RigidTransform.identity("t", "s")
    room_m = _room(0, 4000)
    target = prepare_gicp_cloud("t", room_m[room_m[:, 0] < -3.0], config)
    source = prepare_gicp_cloud("s", room_m * [3.0, 1.0, 1.0], config)
    register(target, source, start, config)
    assert [cloud.name for cloud in (target, source) if "engine_cloud" in vars(cloud)] == ["t"]


def test_the_narrower_cloud_is_the_source():
    target, source = _clouds(FineConfig())
    result = register_narrower(source, target, RigidTransform.identity("s", "t"), FineConfig())
    assert (result.target, result.source) == ("t", "s")
    assert result.T_target_source.distance_to(_TRUTH)[0] < 0.005


def test_short_runs_are_one_step_per_distance():
    target, source = _clouds(FineConfig())
    start = RigidTransform.identity("t", "s")
    short, long = (register(target, source, start, FineConfig(max_iterations=most)) for most in (10, 30))
    assert len(short.steps) == len(FineConfig().max_correspondence_distances_m) < len(long.steps)
    assert short.T_target_source.distance_to(long.T_target_source)[0] < 0.001
