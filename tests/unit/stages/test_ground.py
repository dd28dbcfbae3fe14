# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.config import CalibrationConfig, GroundConfig
from multilica.geometry import RigidTransform
from multilica.stages.ground import estimate_ground, estimate_level


def _street(seed=0):
    """Flat ground and one facade, in the base frame."""
    rng = np.random.default_rng(seed)
    ground = np.stack([*rng.uniform(-15, 15, (2, 20_000)), rng.normal(0, 0.01, 20_000)], axis=1)
    facade = np.stack([rng.uniform(-15, 15, 30_000), np.full(30_000, 8.0), rng.uniform(0, 10, 30_000)], axis=1)
    return np.concatenate([ground, facade])


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(0, 0), (3, -5), (-20, 12), (0, 45)])
def test_roll_pitch_and_height_of_a_tilted_sensor(roll_deg, pitch_deg):
    T_base_target = RigidTransform.from_xyz_rpy("base", "top", [0, 0, 1.9], np.deg2rad([roll_deg, pitch_deg, 0]))
    plane, reason = estimate_ground("top", T_base_target.inverse().apply(_street()), GroundConfig(), seed=0)
    assert plane is not None, reason
    metres, radians = plane.T_base_target.distance_to(T_base_target)
    assert metres < 0.005
    assert radians < np.deg2rad(0.05)
    assert (plane.T_base_target.target, plane.T_base_target.source) == ("base", "top")
    assert plane.T_base_target.xyz_m[:2] == pytest.approx([0.0, 0.0])


def test_equal_runs_find_the_same_bits():
    points_m = _street() - [0.0, 0.0, 1.9]
    found = [estimate_ground("top", points_m, GroundConfig(), seed=0)[0] for _ in range(5)]
    assert len({(plane.normal.tobytes(), plane.offset_m) for plane in found}) == 1


def test_a_facade_is_no_ground():
    only_facade = _street()[20_000:] - [0.0, 0.0, 1.9]
    plane, reason = estimate_ground("top", only_facade, GroundConfig(), seed=0)
    assert plane is None
    assert "top" in reason


def test_a_line_of_points_is_no_ground():
    plane, _ = estimate_ground("top", np.linspace(0.5, 19.5, 500)[:, None] * [1.0, 0.0, 0.0], GroundConfig(), seed=0)
    assert plane is None


def test_too_few_points_are_reported():
    plane, reason = estimate_ground("top", np.zeros((5, 3)), GroundConfig(), seed=0)
    assert plane is None
    assert "1 points are too few" in reason


def test_clouds_of_placed_lidars_give_the_level():
    T_base_target = RigidTransform.from_xyz_rpy("base", "top", [0, 0, 1.9], [0.1, -0.2, 0])
    T_target_source = RigidTransform.from_xyz_rpy("top", "rear", [-2, 0, 0], [0, 0, 3])
    target_m = T_base_target.inverse().apply(_street())
    clouds = {"top": target_m[::2], "rear": T_target_source.inverse().apply(target_m[1::2])}
    poses = {"top": RigidTransform.identity("top", "top"), "rear": T_target_source}
    level = estimate_level("top", clouds, poses, CalibrationConfig())
    assert level.xyz_m[2] == pytest.approx(1.9, abs=0.05)
    assert level.rotation == pytest.approx(T_base_target.rotation, abs=0.02)
    assert estimate_level("top", {"rear": clouds["rear"]}, {}, CalibrationConfig()) is None
