# SPDX-License-Identifier: Apache-2.0
"""Simulated vehicles that drive at every speed of a road, or stand where it is hard to tell."""

from __future__ import annotations

import numpy as np
import pytest

from multilica.config import StillnessConfig
from multilica.geometry import RigidTransform
from multilica.simulate import simulate_snapshot, simulation
from multilica.simulate.scenes import Scene
from multilica.snapshot import Snapshot
from multilica.stages.stillness import detect_motion, explain_motion
from tests.selection import some_of

pytestmark = pytest.mark.slow

FRAMES = 10
PERIOD_S = 0.1
CONFIG = StillnessConfig()
DRIVES = [
    ("street", 30.0, 0.0),
    ("parking", 5.0, 0.0),
    ("garage", 2.0, 0.0),
    ("street", 8.0, 20.0),
    ("garage", 0.0, 30.0),
    ("street", 0.1, 0.0),
    ("street", 14.0, 0.0),
    ("parking", 14.0, 0.0),
    ("garage", 30.0, 0.0),
    ("parking", 3.0, 40.0),
]


def driven(
    monkeypatch: pytest.MonkeyPatch, scene: str, speed_m_s: float, turn_deg_s: float, frames: int = FRAMES
) -> Snapshot:
    """A snapshot on an arc at constant speed and turning rate."""

    def pose(place: Scene, _disturbances: tuple[str, ...], time_s: float) -> RigidTransform:
        turned_rad = np.deg2rad(turn_deg_s) * time_s
        yaw_rad = place.vehicle_yaw_rad + turned_rad
        # The chord of the arc points half as far round.
        way_m = speed_m_s * time_s * np.sinc(turned_rad / 2.0 / np.pi)
        middle_rad = place.vehicle_yaw_rad + turned_rad / 2.0
        x_m, y_m = np.array(place.vehicle_xy_m) + way_m * np.array([np.cos(middle_rad), np.sin(middle_rad)])
        return place.terrain.standing_pose(float(x_m), float(y_m), yaw_rad)

    monkeypatch.setattr(simulation, "_pose", pose)
    return simulate_snapshot("sides", scene, 5, frames=frames).snapshot


@pytest.mark.parametrize(("scene", "speed_m_s", "turn_deg_s"), some_of(DRIVES, 2))
@pytest.mark.in_turn
def test_the_way_and_the_turn_are_right_or_bounds(
    monkeypatch: pytest.MonkeyPatch, scene: str, speed_m_s: float, turn_deg_s: float
) -> None:
    snapshot = driven(monkeypatch, scene, speed_m_s, turn_deg_s)
    motions = {lidar.name: detect_motion(lidar.scans, CONFIG) for lidar in snapshot.lidars}
    refusal = explain_motion(motions)
    assert refusal.startswith("The vehicle moves")
    way_m, turn_rad = speed_m_s * PERIOD_S * (FRAMES - 1), np.deg2rad(turn_deg_s) * PERIOD_S * (FRAMES - 1)
    # A LiDAR beside the axis goes a shorter or a longer way round a turn.
    slack_m = 0.03 + 0.05 * way_m + 2.0 * turn_rad
    # A frame is skewed by the way that the vehicle goes while it is taken: 3 m at 30 m/s.
    slack_rad = np.deg2rad(1.5 + 0.05 * speed_m_s)
    for motion in motions.values():
        assert motion.moving
        assert motion.shift_m < way_m + slack_m
        if not motion.at_least:
            assert motion.shift_m == pytest.approx(way_m, abs=slack_m)
            assert motion.turn_rad == pytest.approx(turn_rad, abs=slack_rad)
    assert sum(not motion.at_least for motion in motions.values()) >= 2
    assert ("at least" in refusal) == any(motion.at_least for motion in motions.values())


@pytest.mark.in_turn
@pytest.mark.parametrize("frames", [2, 3])
def test_a_few_frames_at_high_speed_suffice(monkeypatch: pytest.MonkeyPatch, frames: int) -> None:
    snapshot = driven(monkeypatch, "street", 20.0, 0.0, frames)
    for lidar in snapshot.lidars:
        assert detect_motion(lidar.scans, CONFIG).shift_m == pytest.approx(2.0 * (frames - 1), abs=0.1)


@pytest.mark.parametrize(
    ("rig", "scene", "disturbances"),
    some_of(
        [
            ("helipr", "street", ()),
            ("helipr", "garage", ("rain",)),
            ("sides", "tunnel", ("rain",)),
            ("sides", "open_field", ("pedestrians",)),
            ("helipr", "fence_field", ()),
        ],
        2,
    ),
)
def test_a_vehicle_at_rest_is_not_said_to_move(rig: str, scene: str, disturbances: tuple[str, ...]) -> None:
    """Rosettes, which share a third of their points from frame to frame, and rain in a tunnel among them."""
    snapshot = simulate_snapshot(rig, scene, 11, frames=5, disturbances=disturbances).snapshot
    motions = {lidar.name: detect_motion(lidar.scans, CONFIG) for lidar in snapshot.lidars}
    assert explain_motion(motions) == ""
    assert not any(motion.at_least for motion in motions.values())
