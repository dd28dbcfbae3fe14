# SPDX-License-Identifier: Apache-2.0
"""Where the viewer looks from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results import PreprocessedCloud
from multilica.sinks.rerun import views
from multilica.sinks.rerun.views import above_group, around_lidar, around_rig, beside_lidar
from multilica.sinks.run_state import RunState
from tests.sinks.made_events import made_events


def state_of(points_m: np.ndarray | None = None) -> RunState:
    state = RunState()
    state(next(iter(made_events())))
    if points_m is not None:
        state.clouds["front"] = PreprocessedCloud("front", points_m, points_m, {})
    return state


def line_of_sight(eye) -> np.ndarray:
    """(3,) unit vector from the eye to what it looks at."""
    towards = np.subtract(eye.look_target.as_arrow_array().to_pylist()[0], eye.position.as_arrow_array().to_pylist()[0])
    return towards / np.linalg.norm(towards)


@pytest.mark.parametrize("yaw_deg", [0.0, 90.0, 200.0])
def test_a_wide_view_has_across_what_the_lidar_looks_at(yaw_deg):
    ahead = np.array([np.cos(np.deg2rad(yaw_deg)), np.sin(np.deg2rad(yaw_deg)), 0.0])
    points_m = np.random.default_rng(1).normal(20.0 * ahead, 3.0, (5000, 3))
    sight = line_of_sight(beside_lidar(state_of(points_m), "front"))
    assert abs(sight @ ahead) < 0.4
    assert sight[2] < -0.4


def test_a_lidar_without_returns_is_seen_as_well():
    for eye in (around_lidar(state_of(), "front"), beside_lidar(state_of(), "front")):
        assert np.all(np.isfinite(line_of_sight(eye)))


@pytest.mark.parametrize("rpy_deg", [(180.0, 0.0, 0.0), (0.0, -90.0, 0.0), (90.0, 0.0, 0.0)])
def test_a_target_that_hangs_turned_is_seen_from_above(rpy_deg):
    """Without `--ground` the level of the result is known."""
    state = RunState()
    level = RigidTransform.from_xyz_rpy("level", "top", (0.0, 0.0, 0.0), np.deg2rad(rpy_deg))
    for event in made_events():
        if isinstance(event, events.CalibrationFinished):
            event = events.CalibrationFinished(replace(event.result, ground=None, level=level))  # noqa: PLW2901
        state(event)
    for eye in (around_rig(state), above_group(state)):
        assert (level.rotation @ line_of_sight(eye))[2] < -0.4
        up = np.array(eye.eye_up.as_arrow_array().to_pylist()[0])
        np.testing.assert_allclose(level.rotation @ up, [0.0, 0.0, 1.0], atol=1e-6)


def test_the_extent_of_a_cloud_is_found_once(monkeypatch):
    """It takes a fifth of the time of a recording, as each tab of each stage looks at the same clouds."""
    sampled, state = [], state_of()
    monkeypatch.setattr(views, "sampled_cloud", lambda of, lidar: sampled.append(lidar) or of.clouds[lidar].points_m)
    near_m = np.random.default_rng(1).normal(0.0, 3.0, (5000, 3))
    eyes = {}
    for scale in (1.0, 2.0):
        state(events.CloudPreprocessed(PreprocessedCloud("front", near_m.astype(np.float32), scale * near_m)))
        eyes[scale] = {str(around_lidar(state, "front").position.as_arrow_array()) for _ in range(3)}
    assert sampled == ["front", "front"]
    assert len(eyes[1.0]) == len(eyes[2.0]) == 1
    assert eyes[1.0] != eyes[2.0]
