# SPDX-License-Identifier: Apache-2.0
import numpy as np
import pytest

from multilica.config import CalibrationConfig, with_overrides
from multilica.geometry import RigidTransform
from multilica.stages.ground import estimate_ground, estimate_ground_over, estimate_level, find_levels, rotations_of
from tests.selection import some_of


def _street(seed=0):
    """Flat ground and one facade, in the base frame."""
    rng = np.random.default_rng(seed)
    ground = np.stack([*rng.uniform(-15, 15, (2, 6_000)), rng.normal(0, 0.01, 6_000)], axis=1)
    facade = np.stack([rng.uniform(-15, 15, 9_000), np.full(9_000, 8.0), rng.uniform(0, 10, 9_000)], axis=1)
    return np.concatenate([ground, facade])


@pytest.mark.parametrize(("roll_deg", "pitch_deg"), [(0, 0), (3, -5), (-20, 12), (0, 45)])
def test_roll_pitch_and_height_of_a_tilted_sensor(roll_deg, pitch_deg):
    T_base_target = RigidTransform.from_xyz_rpy("base", "top", [0, 0, 1.9], np.deg2rad([roll_deg, pitch_deg, 0]))
    plane, reason = estimate_ground("top", T_base_target.inverse().apply(_street()), CalibrationConfig())
    assert plane is not None, reason
    metres, radians = plane.T_base_target.distance_to(T_base_target)
    assert metres < 0.005
    assert radians < np.deg2rad(0.05)
    assert plane.T_base_target.xyz_m[:2] == pytest.approx([0.0, 0.0])
    assert (plane.frame, plane.T_base_target.source, plane.doubt) == ("base", "top", "")


KNOWN = RigidTransform.from_xyz_rpy("base_link", "top", [0.4, -0.7, 1.9], np.deg2rad([2.0, 15.0, -80.0]))


def _scatter(rng, height_m, reach_m=15.0):
    """Ground of a height that depends on x and y, seen from 2 m outside the middle of a vehicle on."""
    x, y = rng.uniform(-reach_m, reach_m, (2, 15_000))
    seen = np.hypot(x, y) > 2.0
    return np.stack([x, y, height_m(x, y) + rng.normal(0, 0.006, len(x))], axis=1)[seen]


def _box(rng, low, high):
    """Points on the sides and the top of a box."""
    points = rng.uniform(low, high, (3_000, 3))
    axis = rng.integers(0, 3, len(points))
    points[np.arange(len(points)), axis] = np.where(axis == 0, low[0], np.where(axis == 1, low[1], high[2]))
    return points


HEIGHTS_M = {
    "flat": lambda x, _: 0.0 * x,
    "kerb": lambda _, y: np.where(y > 3.5, 0.13 + 0.02 * (y - 3.5), 0.0),
    "kerbs": lambda _, y: np.where(np.abs(y) > 4.2, 0.12, 0.0),
    "ramp": lambda x, _: np.maximum(0.0, x - 4.0) * 0.12,
    "ramp_down": lambda x, _: -np.maximum(0.0, -4.0 - x) * 0.12,
    "dip": lambda x, _: 0.0006 * x**2,
    "car": lambda x, _: 0.0 * x,
}


def _scene(name, seed=0):
    rng = np.random.default_rng(seed)
    ground_m = _scatter(rng, HEIGHTS_M[name])
    return _behind_car(rng, ground_m) if name == "car" else ground_m


def _behind_car(rng, ground_m):
    """A car at the right hides what is behind it."""
    hidden = (ground_m[:, 1] < -2.2) & (np.abs(ground_m[:, 0]) < -ground_m[:, 1])
    car = [_box(rng, (-2.2, -4.0, 0.2), (2.2, -2.2, 0.9)), _box(rng, (-1.2, -3.9, 0.9), (1.0, -2.3, 1.5))]
    return np.concatenate([ground_m[~hidden], *car])


@pytest.mark.parametrize("scene", HEIGHTS_M)
@pytest.mark.parametrize("seed", some_of(range(3), 1))
def test_what_is_beside_the_vehicle_is_no_ground(scene, seed):
    points_m = KNOWN.inverse().apply(_scene(scene, seed))
    plane, reason = estimate_ground("top", points_m, CalibrationConfig(), KNOWN.inverse().xyz_m, KNOWN)
    assert plane is not None, reason
    assert plane.doubt == ""
    metres, radians = plane.T_base_target.distance_to(KNOWN)
    assert metres < 0.005
    assert radians < np.deg2rad(0.05)
    assert metres < 4.0 * plane.sigma_z_m
    assert np.all(plane.sigma_roll_pitch_deg < 0.2)


@pytest.mark.parametrize(("along", "known", "wheel_m"), [(1.0, KNOWN, 1.4), (0.0, KNOWN, 0.8), (1.0, None, 1.1)])
def test_the_height_is_that_of_the_wheels(along, known, wheel_m):
    """A car stands in a dip of 2 mm at 1 m; LiDARs whose ranges may be off see a part of it as their bias."""
    dip_m = _scatter(np.random.default_rng(0), lambda x, y: 0.002 * (along * x**2 + (1.0 - along) * y**2), 8.0)
    config = with_overrides(
        CalibrationConfig(), ["refine.range_bias_sigma_m=0.0001", "refine.elevation_bias_sigma_deg=0.0001"]
    )
    plane, _ = estimate_ground("top", KNOWN.inverse().apply(dip_m), config, KNOWN.inverse().xyz_m, known)
    assert plane.T_base_target.xyz_m[2] == pytest.approx(1.9 - 0.002 * wheel_m**2, abs=3e-4)


def test_x_y_and_yaw_are_those_of_the_rig_file():
    drawn = RigidTransform.from_xyz_rpy("base_link", "top", [0.4, -0.7, 1.83], np.deg2rad([4.0, 14.0, -80.0]))
    points_m = KNOWN.inverse().apply(_scene("flat"))
    plane, _ = estimate_ground("top", points_m, CalibrationConfig(), KNOWN.inverse().xyz_m, drawn)
    assert max(plane.T_base_target.distance_to(KNOWN)) < 0.005
    assert "The rig file is off by -70 mm" in plane.text
    assert (plane.frame, plane.T_base_target_rig) == ("base_link", drawn)


def test_ground_on_one_side_only_is_in_doubt():
    ahead = _scene("flat")
    ahead = ahead[(ahead[:, 0] > 4.0) & (np.abs(ahead[:, 1]) < ahead[:, 0])]
    plane, _ = estimate_ground("top", KNOWN.inverse().apply(ahead), CalibrationConfig(), None, KNOWN)
    assert "one side" in plane.doubt
    assert "UNCERTAIN" in plane.text


def test_a_ridge_under_the_vehicle_is_in_doubt():
    points_m = KNOWN.inverse().apply(_scatter(np.random.default_rng(0), lambda _, y: -0.08 * np.abs(y)))
    plane, _ = estimate_ground("top", points_m, CalibrationConfig(), KNOWN.inverse().xyz_m, KNOWN)
    assert plane.doubt


def test_rough_ground_has_a_large_sigma():
    points_m = KNOWN.inverse().apply(_scatter(np.random.default_rng(0), lambda x, y: 0.05 * np.sin(1.5 * x + y)))
    plane, _ = estimate_ground("top", points_m, CalibrationConfig(), KNOWN.inverse().xyz_m, KNOWN)
    assert plane.doubt.startswith("sigma ")
    assert plane.sigma_roll_pitch_deg.max() > 0.2


@pytest.mark.slow
def test_equal_runs_find_the_same_bits():
    points_m = _street() - [0.0, 0.0, 1.9]
    found = [estimate_ground("top", points_m, CalibrationConfig())[0] for _ in range(5)]
    assert len({(plane.normal.tobytes(), plane.offset_m) for plane in found}) == 1


def test_a_facade_is_no_ground():
    only_facade = _street()[6_000:] - [0.0, 0.0, 1.9]
    plane, reason = estimate_ground("top", only_facade, CalibrationConfig())
    assert plane is None
    assert "top" in reason


def test_a_line_of_points_is_no_ground():
    plane, _ = estimate_ground("top", np.linspace(0.5, 19.5, 500)[:, None] * [1.0, 0.0, 0.0], CalibrationConfig())
    assert plane is None


def test_too_few_points_are_reported():
    plane, reason = estimate_ground("top", np.zeros((5, 3)), CalibrationConfig())
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


_CEILING = np.stack([*np.random.default_rng(1).uniform(-9, 9, (2, 6_000)), np.full(6_000, 3.4)], axis=1)


@pytest.mark.parametrize("rpy_deg", [(3, -5, 0), (180, 0, 0), (0, -90, 0), (0, 90, 20), (90, 0, 0), (-90, 10, 0)])
@pytest.mark.parametrize("above_m", [np.empty((0, 3)), _CEILING], ids=["street", "below a ceiling"])
def test_the_ground_is_found_whichever_axis_is_up(rpy_deg, above_m):
    """A ceiling and a facade may be the ground."""
    T_base_target = RigidTransform.from_xyz_rpy("level", "top", [0, 0, 1.9], np.deg2rad(rpy_deg))
    points_m = T_base_target.inverse().apply(np.concatenate([_street(), above_m]))
    levels = find_levels("top", {"top": points_m}, {}, CalibrationConfig())
    upright = [float(level.rotation[2] @ T_base_target.rotation[2]) for level in levels]
    (right,) = (level for level, cosine in zip(levels, upright, strict=True) if cosine > 0.999)
    assert right.xyz_m == pytest.approx([0.0, 0.0, 1.9], abs=0.05)
    assert (min(upright) < -0.999) == bool(len(above_m))
    assert len(levels) <= 3
    assert (right is levels[0]) or rpy_deg != (3, -5, 0)
    assert len(rotations_of(levels)) == len(levels)


@pytest.mark.parametrize("rpy_deg", [(180, 3, 0), (90, 0, 0), (0, -88, 0)])
@pytest.mark.parametrize("known", [False, True])
def test_a_target_whose_z_is_not_up_has_its_pose_over_the_ground(rpy_deg, known):
    drawn = RigidTransform.from_xyz_rpy("base", "top", [0.4, -0.7, 1.8], np.deg2rad(rpy_deg))
    points_m = drawn.inverse().apply(_scene("flat") - np.array([0.0, 0.0, 0.1]))
    middle_m, config = np.array([0.1, 0.0, 0.2]), CalibrationConfig()
    assert estimate_ground("top", points_m, config, middle_m)[0] is None
    levels = find_levels("top", {"top": points_m}, {}, config)
    plane, _ = estimate_ground_over(levels, points_m, config, middle_m, drawn if known else None)
    true = RigidTransform.from_rotation_translation("base", "top", drawn.rotation, [0.4, -0.7, 1.9])
    assert plane.normal == pytest.approx(true.rotation[2], abs=2e-3)
    assert plane.T_base_target.xyz_m[2] == plane.offset_m == pytest.approx(1.9, abs=0.01)
    if known:
        metres, radians = plane.T_base_target.distance_to(true)
        assert (metres < 0.01, radians < 0.003, plane.T_base_target_rig) == (True, True, drawn)
    assert ("may be the ground" in plane.doubt) == (len(levels) > 1)


def test_without_ground_each_axis_may_be_up():
    ups = rotations_of(find_levels("top", {"top": np.ones((9, 3))}, {}, CalibrationConfig()))
    assert {tuple(up[2]) for up in ups} == {tuple(sign * axis) for axis in np.eye(3) for sign in (1.0, -1.0)}
    assert np.linalg.det(ups) == pytest.approx(1.0)
