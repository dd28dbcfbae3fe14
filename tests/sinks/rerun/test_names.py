# SPDX-License-Identifier: Apache-2.0
"""Names of dense rigs do not touch in the views that show them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from multilica.geometry import RigidTransform
from multilica.sinks.rerun.names import names_apart
from multilica.sinks.rerun.scene import lidar_path
from multilica.sinks.rerun.views import three_quarter

BELOW_PX = np.array([0.0, 14.0])
SIZE_PX = np.array([500.0, 280.0])
UP = np.array([0.0, 0.0, 1.0])
CENTRE_M = np.array([1.0, -2.0, 0.5])


def ring(count: int, radius_m: float) -> dict[str, RigidTransform]:
    """LiDARs that look outwards, some of them tilted."""
    poses = {}
    for index in range(count):
        angle = 2.0 * np.pi * index / count
        xyz_m = CENTRE_M + radius_m * np.array([np.cos(angle), 0.4 * np.sin(angle), 0.0])
        rotation = Rotation.from_euler("ZYX", [angle, 0.3 * (index % 3), 0.0]).as_matrix()
        poses[f"at_{index:03d}"] = RigidTransform.from_rotation_translation("rig", f"at_{index:03d}", rotation, xyz_m)
    return poses


def vector(batch) -> np.ndarray:
    return np.array(batch.as_arrow_array().to_pylist()[0])


def pixels(point_m: np.ndarray, eye, height_px: float) -> np.ndarray:
    """Project as a camera does whose angle of view is 55 degrees from top to bottom: x right, y down."""
    position, target, up = map(vector, (eye.position, eye.look_target, eye.eye_up))
    z = (target - position) / np.linalg.norm(target - position)
    x = np.cross(z, up) / np.linalg.norm(np.cross(z, up))
    seen = np.stack([x, -np.cross(x, z), z]) @ (point_m - position)
    return seen[:2] / seen[2] * height_px / 2.0 / np.tan(np.deg2rad(27.5))


def tips_m(poses, overrides) -> dict[str, np.ndarray]:
    return {
        name: pose.apply(np.array([vector(overrides[lidar_path(name, "name", "tip")].positions)], dtype=float))[0]
        for name, pose in poses.items()
    }


@pytest.mark.parametrize("scale", [1.0, 1.5])
@pytest.mark.parametrize(("count", "radius_m", "long"), [(20, 2.0, 0), (12, 0.1, 0), (8, 1.5, 4), (3, 1.0, 0)])
def test_no_two_names_touch_and_all_are_in_view(count, radius_m, long, scale):
    poses = ring(count, radius_m)
    labels = {name: f"{name}: uncertain (3 sigma x 10)" if number < long else name for number, name in enumerate(poses)}
    eye = three_quarter(CENTRE_M, 3.0 + radius_m, UP)
    tips = tips_m(poses, names_apart(labels, poses, eye, tuple(SIZE_PX)))
    middles = {name: pixels(tip_m, eye, scale * SIZE_PX[1]) + BELOW_PX for name, tip_m in tips.items()}
    halves = {name: np.array([5.0 + 3.0 * len(label), 12.0]) for name, label in labels.items()}
    for one, other in combinations(poses, 2):
        apart = np.abs(middles[one] - middles[other]) - halves[one] - halves[other]
        assert apart.max() >= 0.0, (one, other)
    for name, middle in middles.items():
        assert np.all(np.abs(middle) + halves[name] <= scale * SIZE_PX / 2.0), name


def test_a_line_leads_from_the_lidar_to_its_name():
    poses = ring(5, 1.0)
    overrides = names_apart({name: name for name in poses}, poses, three_quarter(CENTRE_M, 4.0, UP), tuple(SIZE_PX))
    for name in poses:
        (strip,) = overrides[lidar_path(name, "name")].strips.as_arrow_array().to_pylist()
        assert strip[0] == [0.0, 0.0, 0.0]
        assert strip[1] == pytest.approx(vector(overrides[lidar_path(name, "name", "tip")].positions))


def test_a_view_without_poses_keeps_its_names():
    assert names_apart({}, {}, three_quarter(CENTRE_M, 4.0, UP), tuple(SIZE_PX)) == {}
