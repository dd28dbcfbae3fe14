# SPDX-License-Identifier: Apache-2.0
from types import SimpleNamespace

import numpy as np

from multilica.config import CalibrationConfig, with_overrides
from multilica.geometry import RigidTransform
from multilica.orchestration.state import CalibrationState
from multilica.results import PreprocessedCloud

_AXIS = np.array([0.6, 0.0, 0.8])


def test_a_group_has_the_elevation_axis_of_its_root():
    config = with_overrides(CalibrationConfig(), ["fine.max_points=500"])
    state = CalibrationState(snapshot=None, config=config, observe=lambda _: None)
    points_m = np.random.default_rng(0).uniform(-20.0, 20.0, (400, 3))
    state.clouds = {
        "a": PreprocessedCloud("a", np.float32(points_m), points_m, elevation_axis=_AXIS),
        "b": PreprocessedCloud("b", np.float32(points_m), points_m),
    }
    state.lidars = {name: SimpleNamespace(view=None) for name in state.clouds}
    poses = {"a": RigidTransform.identity("a", "a"), "b": RigidTransform.from_xyz_rpy("a", "b", [1, 0, 0], [0, 0, 1])}
    side = state.side_of("a", poses)
    assert len(side.cloud.points_m) > 200
    assert np.array_equal(side.cloud.elevation_axis, _AXIS)
    assert np.array_equal(state.side_of("b", {"b": poses["a"], "a": poses["a"]}).cloud.elevation_axis, [0.0, 0.0, 1.0])
