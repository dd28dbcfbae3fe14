# SPDX-License-Identifier: Apache-2.0
"""Scene of an open car park."""

import numpy as np

from multilica.simulate.scenes.scene import Scene
from multilica.simulate.shapes.buildings import building
from multilica.simulate.shapes.furniture import lamp_post, sign, trolley_shelter
from multilica.simulate.shapes.mesh import Mesh, merged
from multilica.simulate.shapes.primitives import box
from multilica.simulate.shapes.terrain import Terrain, rolling_waves
from multilica.simulate.shapes.vegetation import bush, hedge, tree
from multilica.simulate.shapes.vehicles import random_car

__all__ = ["parking"]

_SLOT_M = 2.5


def parking(rng: np.random.Generator) -> Scene:
    """Build rows of cars with gaps, islands with trees, lamp posts, hedges and a building behind them."""
    terrain = Terrain(rng.uniform(-0.02, 0.02), rng.uniform(-0.02, 0.02), rolling_waves(rng, 2, (40.0, 90.0), 0.001))
    aisle_m = rng.uniform(6.0, 7.5)
    pitch_m = aisle_m + 10.0
    grid = np.linspace(-120.0, 120.0, 61)
    parts = [terrain.surface(grid, grid)]
    occupancy = rng.uniform(0.35, 0.8)
    for lane in range(-2, 2):
        parts += _double_row(rng, terrain, (lane + 0.5) * pitch_m, occupancy)
    parts += _border(rng, terrain, 2.0 * pitch_m + rng.uniform(3.0, 8.0))
    parts += _market(rng, terrain, 2.0 * pitch_m + rng.uniform(10.0, 18.0))
    yaw_rad = float(rng.choice([0.0, np.pi])) + rng.normal(scale=0.15)
    return Scene(merged(parts), terrain, (rng.uniform(-8.0, 8.0), rng.uniform(-0.8, 0.8)), yaw_rad)


def _double_row(rng: np.random.Generator, terrain: Terrain, middle_y_m: float, occupancy: float) -> list[Mesh]:
    """Build two rows of slots back to back, some of them replaced by green islands."""
    parts: list[Mesh] = []
    for x_m in np.arange(-35.0, 35.0, _SLOT_M):
        if rng.random() < 0.08:
            parts += _island(rng, terrain, x_m, middle_y_m)
            continue
        for side in (-1.0, 1.0):
            if rng.random() < occupancy:
                y_m = middle_y_m + side * (2.5 + rng.normal(scale=0.2))
                yaw_rad = side * np.pi / 2.0 + rng.normal(scale=0.03)
                parts.append(terrain.place(random_car(rng), x_m + rng.normal(scale=0.1), y_m, yaw_rad))
    for x_m in np.arange(-30.0 + rng.uniform(0.0, 10.0), 32.0, 20.0):
        post = lamp_post(rng.uniform(5.0, 9.0), 1.0)
        parts.append(terrain.place(post, x_m + _SLOT_M / 2.0, middle_y_m, float(rng.choice([-1.0, 1.0])) * np.pi / 2.0))
    return parts


def _island(rng: np.random.Generator, terrain: Terrain, x_m: float, y_m: float) -> list[Mesh]:
    kerb = box((-1.1, -4.6, -0.2), (1.1, 4.6, 0.14))
    plants = [
        terrain.place(tree(rng, rng.uniform(3.5, 7.0)), x_m, y_m + rng.uniform(-3.0, 3.0)),
        terrain.place(bush(rng, rng.uniform(0.5, 0.9)), x_m, y_m + rng.uniform(-4.0, 4.0)),
    ]
    return [terrain.place(kerb, x_m, y_m), *plants]


def _border(rng: np.random.Generator, terrain: Terrain, reach_m: float) -> list[Mesh]:
    """Build hedges and trees around the site, different on each side."""
    parts = []
    for turn in (0.0, np.pi / 2.0, -np.pi / 2.0):
        start_m, length_m = rng.uniform(-38.0, -10.0), rng.uniform(20.0, 50.0)
        row = hedge(rng, length_m, rng.uniform(0.8, 1.8)).moved(start_m, -reach_m - rng.uniform(0.0, 4.0), 0.0)
        parts.append(terrain.drape(row.moved(yaw_rad=turn)))
        for x_m in rng.uniform(-40.0, 40.0, size=int(rng.integers(2, 6))):
            spot = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ [x_m, -reach_m - 4.0]
            parts.append(terrain.place(tree(rng, rng.uniform(4.0, 11.0)), float(spot[0]), float(spot[1])))
    return parts


def _market(rng: np.random.Generator, terrain: Terrain, front_y_m: float) -> list[Mesh]:
    """Build a shop with signs and trolleys, sometimes with another building."""
    width_m = rng.uniform(30.0, 55.0)
    x_m = rng.uniform(-40.0, -10.0)
    entrance_m = rng.uniform(0.2, 0.7) * width_m
    canopy = box((entrance_m, -4.0, 3.2), (entrance_m + 8.0, 0.0, 3.7))
    piers = [box((entrance_m + x, -3.8, -0.5), (entrance_m + x + 0.4, -3.4, 3.2)) for x in (0.2, 7.4)]
    shop = merged([building(rng, width_m, 20.0), canopy, *piers])
    parts = [terrain.place(shop, x_m, front_y_m)]
    parts.append(terrain.place(trolley_shelter(rng), rng.uniform(-25.0, 20.0), front_y_m - 7.0))
    parts += [terrain.place(sign(rng), x, front_y_m - 5.0, rng.uniform(0.0, 3.0)) for x in rng.uniform(-25.0, 25.0, 3)]
    if rng.random() < 0.7:
        house = building(rng, rng.uniform(12.0, 25.0), 10.0)
        parts.append(terrain.place(house, 48.0, rng.uniform(-25.0, 5.0), -np.pi / 2.0))
    return parts
