# SPDX-License-Identifier: Apache-2.0
"""Streets of a town: one with corners, one where places look alike."""

from collections.abc import Iterator

import numpy as np

from multilica.simulate.scenes.roads import TWO_LANES
from multilica.simulate.scenes.scene import Scene, Terrain
from multilica.simulate.shapes.buildings import building
from multilica.simulate.shapes.mesh import Mesh, box
from multilica.simulate.shapes.objects import bench, lamp_post, random_car, refuse_bin, sign, tree

_REACH_M = 90.0
_KERB_M = 0.13
_CORNER_M = 14.0
_QUARTER_RAD = np.pi / 2.0
_HALF_ROAD_M = 4.5


def town(rng: np.random.Generator) -> Scene:
    """Build a crossing of two streets, with houses, parked cars, trees and posts along all four arms."""
    terrain = Terrain(rng.uniform(-0.015, 0.015), rng.uniform(-0.015, 0.015))
    road_m = rng.uniform(4.5, 6.0)
    front_m = road_m + rng.uniform(2.5, 4.5)
    edges_m = np.array([-_REACH_M, _REACH_M])
    parts = [terrain.surface(edges_m, edges_m)]
    for quarter in range(4):
        pavement = box((road_m, road_m, -0.5), (_REACH_M, _REACH_M, _KERB_M))
        left = [house.moved(0.0, front_m) for house in _houses(rng, front_m, _REACH_M)]
        left += _beside(rng, road_m, front_m, 60.0)
        # A quarter turn to the right lays what stands beside -x beside +y.
        right = [house.moved(0.0, front_m) for house in _houses(rng, -_REACH_M, -front_m - _CORNER_M)]
        right += _beside(rng, road_m, -60.0, -front_m)
        built = [pavement, *left, *(part.moved(yaw_rad=-_QUARTER_RAD) for part in right)]
        parts += [terrain.drape(part.moved(yaw_rad=quarter * _QUARTER_RAD)) for part in built]
    stand = (rng.uniform(-9.0, -5.0), TWO_LANES[0][0] + rng.normal(scale=0.15))
    return Scene(tuple(parts), terrain, stand, rng.normal(scale=0.03), lanes=TWO_LANES)


def _houses(rng: np.random.Generator, start_m: float, end_m: float) -> Iterator[Mesh]:
    """Build houses of many kinds along x, with their fronts in the plane y = 0, and a gap now and then."""
    x_m = start_m
    while x_m < end_m - 7.0:
        width_m = min(rng.uniform(8.0, 18.0), end_m - x_m)
        yield building(rng, width_m, rng.uniform(8.0, 12.0)).moved(x_m)
        x_m += width_m + float(rng.choice([0.0, 0.0, 0.0, 3.0, 8.0]))


def _beside(rng: np.random.Generator, road_m: float, start_m: float, end_m: float) -> list[Mesh]:
    """Build what stands at the kerb of a street along x, y = `road_m`, between two places."""
    spots_m = np.arange(start_m + 2.0, end_m - 3.0, 6.0) + rng.normal(scale=0.3)
    share, edge_m = rng.uniform(0.2, 0.7), road_m + 0.5
    cars = [
        random_car(rng).moved(x, road_m - 1.1 - abs(rng.normal(scale=0.08))) for x in spots_m if rng.random() < share
    ]
    lamp = lamp_post(rng.uniform(5.0, 8.0), 1.2).moved(yaw_rad=-_QUARTER_RAD)
    lamps = [lamp.moved(x, edge_m) for x in np.arange(start_m + rng.uniform(1.0, 20.0), end_m, rng.uniform(18.0, 28.0))]
    things = [tree(rng, rng.uniform(4.5, 9.0)) if rng.random() < 0.5 else sign(rng) for _ in range(4)]
    things += [refuse_bin(rng) if rng.random() < 0.6 else bench() for _ in range(2)]
    return [*cars, *lamps, *(thing.moved(rng.uniform(start_m, end_m), edge_m, _KERB_M) for thing in things)]


def equal_houses(rng: np.random.Generator) -> Scene:
    """Build a street of equal houses at equal distances, with a tree each; by seed a bench and a sign among them."""
    terrain = Terrain(rng.uniform(-0.02, 0.02))
    front_m, width_m = _HALF_ROAD_M + rng.uniform(3.5, 6.0), rng.uniform(6.0, 9.0)
    pitch_m = width_m + rng.uniform(0.0, 4.0)
    spots_m = np.arange(-_REACH_M + rng.uniform(0.0, pitch_m), _REACH_M, pitch_m)
    house, trunk = building(rng, width_m, 9.0), tree(rng, rng.uniform(4.0, 6.0))
    edges_m = np.array([-_REACH_M, _REACH_M])
    parts = [terrain.surface(edges_m, edges_m)]
    for side_rad in (0.0, np.pi):
        built = [box((x, _HALF_ROAD_M, -0.5), (x + pitch_m, front_m + 40.0, _KERB_M)) for x in spots_m]
        built += [house.moved(x, front_m) for x in spots_m]
        built += [trunk.moved(x + width_m / 2.0, _HALF_ROAD_M + 0.8, _KERB_M) for x in spots_m]
        parts += [terrain.drape(part.moved(yaw_rad=side_rad)) for part in built]
    if rng.random() < 0.5:
        for thing in (bench(), sign(rng)):
            y_m = float(rng.choice([-1.0, 1.0])) * (_HALF_ROAD_M + 1.6)
            parts.append(terrain.place(thing, rng.uniform(-25.0, 25.0), y_m, 0.0, -_KERB_M))
    stand = (rng.uniform(-8.0, 0.0), TWO_LANES[0][0] + rng.normal(scale=0.15))
    return Scene(tuple(parts), terrain, stand, rng.normal(scale=0.015), lanes=TWO_LANES)
