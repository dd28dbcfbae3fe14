# SPDX-License-Identifier: Apache-2.0
"""Scenes of open land."""

import numpy as np

from multilica.simulate.scenes.scene import FLAT, Scene, Terrain, rolling_waves
from multilica.simulate.shapes.buildings import shed
from multilica.simulate.shapes.mesh import Mesh, box, cylinder, merged
from multilica.simulate.shapes.street_objects import bush, fence, hay_bale, post_fence, sign, tree
from multilica.simulate.shapes.vehicles import random_car

_SECTORS = 12


def open_field(rng: np.random.Generator) -> Scene:
    """Build rolling ground with trees, bushes, a shed, bales and a distant fence, in all directions."""
    terrain = Terrain(
        rng.uniform(-0.02, 0.02),
        rng.uniform(-0.02, 0.02),
        (*rolling_waves(rng, 3, (25.0, 70.0), 0.006), *rolling_waves(rng, 6, (3.0, 9.0), 0.004)),
    )
    grid = np.linspace(-100.0, 100.0, 201)
    parts = [terrain.surface(grid, grid)]
    for near_m, far_m in ((7.0, 18.0), (16.0, 38.0)):
        parts += [_growth_in_sector(rng, terrain, sector, rng.uniform(near_m, far_m)) for sector in range(_SECTORS)]
    parts += _farm(rng, terrain)
    return Scene(tuple(parts), terrain, (rng.uniform(-2.0, 2.0), rng.uniform(-2.0, 2.0)), rng.uniform(-np.pi, np.pi))


def _growth_in_sector(rng: np.random.Generator, terrain: Terrain, sector: int, range_m: float) -> Mesh:
    azimuth_rad = (sector + rng.random()) * 2.0 * np.pi / _SECTORS
    x_m, y_m = range_m * float(np.cos(azimuth_rad)), range_m * float(np.sin(azimuth_rad))
    return terrain.place(_growth(rng), x_m, y_m, rng.uniform(0.0, 2.0 * np.pi), 0.1)


def _growth(rng: np.random.Generator) -> Mesh:
    kind = rng.choice(["tree", "tree", "tree", "bush", "bush", "bale", "stump", "mast"])
    if kind == "tree":
        return tree(rng, rng.uniform(3.0, 11.0))
    if kind == "bush":
        return bush(rng, rng.uniform(0.6, 1.8))
    if kind == "bale":
        return hay_bale(rng)
    if kind == "stump":
        return cylinder(rng.uniform(0.2, 0.5), -0.2, rng.uniform(0.4, 1.0))
    return merged([cylinder(0.13, -0.3, 8.0, top_radius_m=0.09), box((-0.9, -0.06, 7.3), (0.9, 0.06, 7.45))])


def _farm(rng: np.random.Generator, terrain: Terrain) -> list[Mesh]:
    """Build a shed with a car beside it, bales, a pasture fence and a sign."""
    azimuth_rad, range_m = rng.uniform(-np.pi, np.pi), rng.uniform(14.0, 30.0)
    x_m, y_m = range_m * np.cos(azimuth_rad), range_m * np.sin(azimuth_rad)
    turn_rad = rng.uniform(-np.pi, np.pi)
    parts = [terrain.place(shed(rng), x_m, y_m, turn_rad, 0.1)]
    car_x_m, car_y_m = x_m + 7.0 * np.cos(turn_rad), y_m + 7.0 * np.sin(turn_rad)
    parts.append(terrain.place(random_car(rng), car_x_m, car_y_m, turn_rad + 0.4))
    spots = rng.uniform(-40.0, 40.0, size=(int(rng.integers(4, 10)), 2)).tolist()
    far = [(x, y) for x, y in spots if np.hypot(x, y) > 9.0]
    parts += [terrain.place(hay_bale(rng), x, y, rng.uniform(0.0, np.pi)) for x, y in far]
    pasture = post_fence(rng, 70.0).moved(-35.0, rng.uniform(32.0, 45.0))
    parts.append(terrain.drape(pasture.moved(yaw_rad=rng.uniform(-np.pi, np.pi))))
    parts.append(terrain.place(sign(rng), rng.uniform(6.0, 12.0), rng.uniform(-9.0, 9.0), rng.uniform(0.0, np.pi)))
    return parts


def fence_field(rng: np.random.Generator) -> Scene:
    """Build a flat field with one straight seamless fence, along which the position is not observable."""
    edges = np.array([-200.0, 200.0])
    field = FLAT.surface(edges, edges)
    line = fence(-200.0, 200.0, rng.uniform(1.2, 2.0)).moved(0.0, rng.uniform(5.0, 12.0))
    return Scene((field, line), FLAT, (0.0, 0.0), rng.uniform(-np.pi, np.pi))
