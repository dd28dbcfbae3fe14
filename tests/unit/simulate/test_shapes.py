# SPDX-License-Identifier: Apache-2.0
"""Building blocks and beam patterns."""

from __future__ import annotations

import numpy as np
import pytest

from multilica.errors import UsageError
from multilica.simulate.scenes import SCENES
from multilica.simulate.scenes.scene import FLAT, Terrain, rolling_waves
from multilica.simulate.sensors import RasterPattern, RosettePattern, SpinningPattern
from multilica.simulate.shapes.mesh import Mesh, box, cylinder, merged, reaches_into, tube
from multilica.simulate.shapes.objects import CAR_SHAPES, car


def area_m2(mesh) -> float:
    a, b, c = (mesh.vertices_m[mesh.triangles[:, corner]] for corner in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2.0)


def test_primitives_have_their_area():
    assert area_m2(box((0, 0, 0), (1, 2, 3))) == pytest.approx(22.0)
    assert area_m2(cylinder(1.0, 0.0, 2.0, sides=200)) == pytest.approx(6.0 * np.pi, rel=1e-3)
    assert area_m2(FLAT.surface(np.array([0.0, 1.0, 3.0]), np.array([0.0, 2.0]))) == pytest.approx(6.0)


def test_a_tube_joins_its_ends():
    start, end = np.array([1.0, 2.0, 3.0]), np.array([-2.0, 4.0, 3.5])
    vertices = tube(start, end, 0.1).vertices_m
    axis = (end - start) / np.linalg.norm(end - start)
    along = (vertices - start) @ axis
    assert along.min() == pytest.approx(0.0, abs=1e-9)
    assert along.max() == pytest.approx(np.linalg.norm(end - start))
    assert np.linalg.norm(vertices - start - along[:, None] * axis, axis=1).max() == pytest.approx(0.1)


def test_merged_keeps_all_triangles():
    parts = [box((0, 0, 0), (1, 1, 1)), box((5, 0, 0), (6, 1, 1))]
    both = merged(parts)
    assert area_m2(both) == pytest.approx(12.0)
    assert both.vertices_m[both.triangles[-1]].min(axis=0)[0] >= 5.0
    assert merged([]).triangles.shape == (0, 3)


@pytest.mark.parametrize("name", sorted(CAR_SHAPES))
def test_cars_stand_on_their_wheels(name):
    vertices = car(CAR_SHAPES[name]).vertices_m
    assert vertices[:, 2].min() == pytest.approx(0.0, abs=1e-6)
    assert vertices[:, 2].max() == pytest.approx(CAR_SHAPES[name].height_m)


def test_a_vehicle_stands_square_on_a_slope():
    terrain = Terrain(0.05, -0.02)
    pose = terrain.standing_pose(3.0, -2.0, 0.7)
    ahead = pose.apply([[2.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    np.testing.assert_allclose(ahead[:, 2], terrain.height_m(ahead[:, 0], ahead[:, 1]), atol=1e-9)
    forward = pose.rotation[:, 0]
    assert np.arctan2(forward[1], forward[0]) == pytest.approx(0.7)


def test_waves_follow_their_steepness():
    waves = rolling_waves(np.random.default_rng(1), 5, (10.0, 20.0), 0.01)
    assert all(0.1 <= amplitude_m <= 0.2 for amplitude_m, *_ in waves)


@pytest.mark.parametrize("name", sorted(SCENES))
@pytest.mark.in_turn
def test_vehicles_stand_clear_of_the_scene(name):
    for seed in range(2):
        scene = SCENES[name](np.random.default_rng(seed))
        whole = merged(scene.parts)
        low, high = np.array([-2.4, -0.95, 0.4]), np.array([2.4, 0.95, 2.2])
        assert not reaches_into(whole.transformed(scene.T_world_base.inverse()), low, high)
        assert np.isfinite(whole.vertices_m).all()


def test_a_long_vehicle_finds_room():
    scene = SCENES["street"](np.random.default_rng(3))
    low, high = np.array([-30.0, -4.0, 0.6]), np.array([30.0, 4.0, 3.0])
    cleared = scene.with_room_for(low, high)
    assert len(scene.parts) - 20 < len(cleared.parts) < len(scene.parts)
    assert not reaches_into(merged(cleared.parts).transformed(scene.T_world_base.inverse()), low, high)


def test_a_fence_is_not_left_out():
    scene = SCENES["fence_field"](np.random.default_rng(3))
    with pytest.raises(UsageError, match="a structure 400 m long is in its way; choose another seed"):
        scene.with_room_for(np.array([-15.0, -15.0, 0.5]), np.array([15.0, 15.0, 2.0]))


@pytest.mark.parametrize(
    ("corners", "touches"),
    [
        ([[-9, 0, 0], [9, 0, 0], [9, 0, 9]], True),
        ([[3, 0, 0], [0, 3, 0], [3, 3, 0]], False),
        ([[1.9, 0, 0], [0, 1.9, 0], [3, 3, 0]], True),
        ([[9, -9, 1.1], [9, 9, 1.1], [-30, 0, 1.1]], False),
        ([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], True),
        ([[5, 0, 0], [0, 5, 0], [0, 0, 5]], False),
    ],
)
def test_triangles_that_reach_into_a_box(corners, touches):
    mesh = Mesh(np.array(corners, dtype=float), np.array([[0, 1, 2]]))
    assert reaches_into(mesh, np.full(3, -1.0), np.full(3, 1.0)) is touches


@pytest.mark.parametrize(
    ("pattern", "vertical_fov_deg"),
    [
        (SpinningPattern(32, 90, (-15.0, 15.0)), 30.0),
        (RasterPattern(20, 60, 120.0, 25.0), 25.0),
        (RosettePattern(2400, 70.0, 77.0), 77.0),
    ],
)
def test_patterns_fill_their_field_of_view(pattern, vertical_fov_deg):
    directions = pattern.directions(0, np.random.default_rng(1))
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    elevation = np.rad2deg(np.arcsin(directions[:, 2]))
    azimuth = np.rad2deg(np.arctan2(directions[:, 1], directions[:, 0]))
    assert np.ptp(elevation) > 0.9 * vertical_fov_deg
    assert np.ptp(azimuth) > 0.9 * pattern.horizontal_fov_deg


def test_a_rosette_does_not_repeat_itself():
    pattern = RosettePattern(24_000, 70.4, 77.2)
    cells = []
    for frames in (1, 5):
        beams = np.concatenate([pattern.directions(frame, np.random.default_rng(0)) for frame in range(frames)])
        cells.append(len(np.unique(np.round(beams[:, 1:] / 0.02).astype(int), axis=0)))
    assert cells[1] > 1.3 * cells[0]
