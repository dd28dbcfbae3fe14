# SPDX-License-Identifier: Apache-2.0
"""A prepared LiDAR is copied to workers without what it builds on first use."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from multilica.config import CalibrationConfig, with_overrides
from multilica.geometry import RigidTransform
from multilica.orchestration.pairs import PreparedLidar, prepare_lidar, register_sides
from multilica.registration.fixed_pair import PartlyFixedCloud
from multilica.results import Hypothesis
from multilica.visibility.sensor_view import score_pose
from tests.unit.made_rooms import HALL, scan

_CONFIG = CalibrationConfig()
_TARGET = RigidTransform.from_xyz_rpy("world", "t", [-1.0, 0.0, 1.8], [0.03, 0.1, 0.4])
_SOURCE = RigidTransform.from_xyz_rpy("world", "s", [1.0, 0.8, 1.6], [-0.1, 0.2, -1.2])
_TRUTH = _TARGET.inverse() @ _SOURCE


def _prepared(config=_CONFIG):
    clouds = scan("t", _TARGET, HALL), scan("s", _SOURCE, HALL, seed=1)
    return [prepare_lidar(cloud, config) for cloud in clouds]


@pytest.fixture(scope="module")
def lidars():
    return _prepared()


def _copied(lidars):
    return [pickle.loads(pickle.dumps(lidar)) for lidar in lidars]  # noqa: S301


def _registered(lidars):
    target, source = lidars
    return register_sides(target.side, source.side, [Hypothesis(_TRUTH)], _CONFIG)


@pytest.mark.slow
def test_a_copy_gives_the_same_bits(lidars):
    one, other = (_registered(each) for each in (lidars, _copied(lidars)))
    assert one.T_target_source.matrix.tobytes() == other.T_target_source.matrix.tobytes()
    assert one.information.tobytes() == other.information.tobytes()
    assert one.evidence == other.evidence
    scores = [score_pose(*(each.view for each in pair), _TRUTH, 0.15, 0.5) for pair in (lidars, _copied(lidars))]
    first, second = (score.visibility for score in scores)
    assert np.array_equal(first.labels, second.labels)
    assert first.information.tobytes() == second.information.tobytes()


def test_a_copy_builds_its_sides_itself(lidars):
    lidar = lidars[0]
    before = len(pickle.dumps(lidar))
    assert lidar.side is lidar.side
    assert lidar.verification_cloud.cloud is lidar.verification_cloud.cloud
    lidar.features_at(0.5)
    assert len(pickle.dumps(lidar)) == before
    (copy,) = _copied([lidar])
    assert "side" not in vars(copy)
    assert copy.features_at(0.5).descriptors.tobytes() == lidar.features_at(0.5).descriptors.tobytes()


def test_all_clouds_have_the_axis_of_the_lidar(lidars):
    axis = np.array([0.0, 0.6, 0.8])
    lidar = PreparedLidar(replace(lidars[0].cloud, elevation_axis=axis), lidars[0].features, lidars[0].view, _CONFIG)
    (copy,) = _copied([lidar])
    thinned = replace(copy.side, finalist_gicp=_CONFIG.fine.model_copy(update={"max_points": 500})).thinned
    movable = PartlyFixedCloud(copy.side.cloud, np.arange(len(copy.side.cloud.points_m)) % 2 == 0, _CONFIG.fine)
    for cloud in (copy.side.cloud, copy.verification_cloud.cloud, thinned, movable.fixed, movable.few):
        assert np.array_equal(cloud.elevation_axis, axis)
        assert np.array_equal(pickle.loads(pickle.dumps(cloud)).elevation_axis, axis)  # noqa: S301


def test_the_usual_descriptors_are_not_computed_again(lidars):
    lidar = lidars[0]
    assert lidar.features_at(_CONFIG.features.voxel_size_m) is lidar.features
    assert lidar.features_at(0.5) is lidar.features_at(0.5)
    assert len(lidar.features_at(0.5).points_m) < len(lidar.features.points_m)


def test_without_verification_there_is_no_view():
    for lidar in _prepared(with_overrides(_CONFIG, ["verify.enabled=false"])):
        assert lidar.view is None
        assert lidar.side.views == ()


def test_the_returns_are_left_out(lidars):
    assert len(lidars[0].cloud.returns_m) == 0
    assert len(lidars[0].cloud.points_m) > 1000


def test_views_at_stops_are_scored_as_such(lidars):
    for lidar in lidars:
        assert lidar.side.views
        assert lidar.verification_cloud.view is lidar.view
    views = [lidar.as_view(f"{lidar.cloud.lidar} at stop 1", _CONFIG) for lidar in lidars]
    for found, at_stops in ((lidars, False), (views, True)):
        sides = (
            [each.view for each in found],
            [each.verification_cloud.view for each in found],
            [each.side.views[0][1] for each in found],
        )
        for target, source in sides:
            pose = RigidTransform(target.lidar, source.lidar, _TRUTH.matrix)
            assert score_pose(target, source, pose, 0.15, 0.5).visibility.between_stops == at_stops
