# SPDX-License-Identifier: Apache-2.0
"""Scenes that repeat do so exactly, and traffic moves as it says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from multilica.errors import UnknownNameError, UsageError
from multilica.geometry import FloatArray
from multilica.simulate import RIGS, SCENES, simulate_snapshot
from multilica.simulate.disturbances import require_known
from multilica.simulate.shapes.mesh import Mesh, box, merged, reaches_into, repeated
from multilica.simulate.shapes.roadside import guard_rail, noise_wall, railing
from multilica.simulate.traffic import FLOWS, LONGEST_DELAY_S, random_traffic, traffic

WITH_LANES = ("avenue", "bridge", "motorway", "tunnel_niches")


def built(scene: str, seed: int):
    return SCENES[scene](np.random.default_rng(seed))


def alike(parts: tuple[Mesh, ...], size: int) -> FloatArray:
    """First vertices (N, 3) of the parts that are shifted copies of the most frequent part with at least that size."""
    large = [part.vertices_m for part in parts if len(part.vertices_m) >= size]
    groups = [
        [other[0] for other in large if other.shape == one.shape and np.allclose(other - other[0], one - one[0])]
        for one in large
    ]
    return np.array(max(groups, key=len))


def test_copies_are_shifted_along_x():
    row = repeated(box((0, 0, 0), (1, 1, 1)), np.array([0.0, 3.0, 7.0]))
    single = box((0, 0, 0), (1, 1, 1))
    copies = merged([single.moved(x) for x in (0.0, 3.0, 7.0)])
    np.testing.assert_allclose(row.vertices_m, copies.vertices_m)
    np.testing.assert_array_equal(row.triangles, copies.triangles)


@pytest.mark.parametrize(
    ("mesh", "pitch_m"),
    [(guard_rail(50.0, 1.3), 4.0), (noise_wall(50.0, 3.0, 2.1), 5.0), (railing(20.0, 0.125), 0.125)],
)
def test_rails_and_walls_repeat(mesh: Mesh, pitch_m: float):
    inner = mesh.vertices_m[np.abs(mesh.vertices_m[:, 0]) < 12.0]
    ends = np.abs(mesh.vertices_m[:, 0]) >= mesh.length_m / 2.0 - 0.2
    tree = cKDTree(mesh.vertices_m[~ends])
    steps, along_m = 16 if pitch_m < 1.0 else 1, np.array([pitch_m, 0.0, 0.0])
    assert tree.query(inner + steps * along_m)[0].max() < 1e-9
    assert tree.query(inner + 0.5 * along_m)[0].max() > 0.02


def test_a_court_is_the_same_after_a_quarter_turn():
    for seed in range(3):
        whole = merged(built("court", seed).parts)
        turned = whole.moved(yaw_rad=np.pi / 2.0)
        assert cKDTree(whole.vertices_m).query(turned.vertices_m)[0].max() < 1e-9


@pytest.mark.parametrize("scene", ["avenue", "bridge"])
def test_trees_and_lamp_posts_stand_at_equal_distances(scene: str):
    spots_m = alike(built(scene, 3).parts, 80)
    assert len(spots_m) > 7
    assert np.ptp(np.diff(np.sort(spots_m[:, 0]))) < 1e-9


def test_niches_lie_at_equal_distances():
    (walls,) = built("tunnel_niches", 2).parts
    y_m = np.abs(walls.vertices_m[:, 1])
    x_m = np.unique(np.round(walls.vertices_m[y_m > y_m.max() - 1e-6, 0], 6))
    starts_m, ends_m = x_m[::2], x_m[1::2]
    assert np.ptp(np.diff(starts_m)) < 1e-5
    assert np.ptp(ends_m - starts_m) < 1e-5


def test_a_motorway_has_a_lorry_and_a_gantry_ahead():
    sides = set()
    for seed in range(12):
        scene = built("motorway", seed)
        heights_m = [np.ptp(part.vertices_m[:, 2]) for part in scene.parts]
        ahead = [part for part in scene.parts if part.vertices_m[:, 0].min() > scene.vehicle_xy_m[0] + 8.0]
        assert sum(10.0 <= part.length_m <= 25.0 for part in ahead) >= 2, seed
        long_walls = [part for part in scene.parts if part.length_m > 300.0 and len(part.triangles) > 500]
        sides.add(len(long_walls))
        assert max(heights_m) > 7.0
    assert sides == {4, 5}


@pytest.mark.parametrize("scene", WITH_LANES)
@pytest.mark.parametrize("flow", sorted(FLOWS))
def test_cars_drive_beside_the_vehicle(scene: str, flow: str):
    low_m, high_m = RIGS["truck"].room_m
    for seed in range(3):
        standing = built(scene, seed)
        cars = random_traffic(standing, FLOWS[flow], np.random.default_rng(seed))
        assert len(cars) > 2
        directions = {car.velocity_m_s > 0.0 for car in cars}
        assert len(directions) == (2 if FLOWS[flow].both_ways and scene == "motorway" else 1)
        for time_s in (0.0, 0.5, 1.0):
            in_base = traffic(standing, cars, time_s).transformed(standing.T_world_base.inverse())
            assert not reaches_into(in_base, low_m, high_m)


def test_a_car_is_elsewhere_in_the_scan_of_each_lidar():
    scene = built("motorway", 1)
    cars = random_traffic(scene, FLOWS["both_ways"], np.random.default_rng(1))
    first, last = (traffic(scene, cars, time_s).vertices_m for time_s in (0.0, LONGEST_DELAY_S))
    ways_m = np.abs(last - first)[:, 0]
    assert 0.9 - 1e-9 <= ways_m.min() <= ways_m.max() <= 1.5 + 1e-9
    assert np.abs(last - first)[:, 1].max() == 0.0


def test_lidars_that_see_traffic_are_not_synchronised():
    clean, busy = (
        simulate_snapshot("chain", "motorway", 3, frames=2, disturbances=some, sensors="ideal").snapshot
        for some in ((), ("traffic:queue",))
    )
    starts_ns = {lidar.scans[0].stamp_ns - clean[lidar.name].scans[0].stamp_ns for lidar in busy.lidars}
    assert len(starts_ns) == len(busy.lidars)
    assert 0 <= min(starts_ns) < max(starts_ns) <= round(LONGEST_DELAY_S * 1e9)
    for lidar in busy.lidars:
        assert lidar.scans[1].stamp_ns - lidar.scans[0].stamp_ns == 100_000_000
    assert any(len(lidar.points_m) != len(clean[lidar.name].points_m) for lidar in busy.lidars)


def test_traffic_needs_lanes_and_a_known_flow():
    with pytest.raises(UsageError, match="needs a scene with lanes"):
        simulate_snapshot("chain", "court", 1, frames=1, disturbances=("traffic:queue",), sensors="ideal")
    with pytest.raises(UnknownNameError, match=r"There is no traffic 'oneway'.*Did you mean 'one_way'"):
        require_known(("traffic:oneway",), "edgar", ["front"])
