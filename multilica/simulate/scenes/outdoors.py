# SPDX-License-Identifier: Apache-2.0
"""Scenes above ground, in town and in open land."""

from dataclasses import dataclass

import numpy as np

from multilica.simulate.scenes.scene import FLAT, Scene, Terrain, rolling_waves
from multilica.simulate.shapes.buildings import building, shed
from multilica.simulate.shapes.mesh import Mesh, box, cylinder, extrusion, merged
from multilica.simulate.shapes.objects import (
    bench,
    bush,
    fence,
    hay_bale,
    hedge,
    lamp_post,
    post_fence,
    random_car,
    refuse_bin,
    sign,
    tree,
    trolley_shelter,
)

_SECTORS = 12
_REACH_M = 110.0
_KERB_M = 0.13
_SLOT_M = 2.5


@dataclass(frozen=True, slots=True)
class _StreetSide:
    """One side of the street, built along +x with its houses towards +y, then rotated by `yaw_rad`."""

    terrain: Terrain
    yaw_rad: float
    kerb_y_m: float
    front_y_m: float

    def place(self, mesh: Mesh, x_m: float, y_m: float, raised_m: float = 0.0) -> Mesh:
        turn = float(np.cos(self.yaw_rad))
        return self.terrain.place(mesh, turn * x_m, turn * y_m, self.yaw_rad, -raised_m)

    def drape(self, mesh: Mesh) -> Mesh:
        return self.terrain.drape(mesh.moved(yaw_rad=self.yaw_rad))


def street(rng: np.random.Generator) -> Scene:
    """Build a sloping road with houses of many kinds, side streets, parked cars, trees and posts."""
    waves = rolling_waves(rng, 1, (60.0, 140.0), 0.002)
    terrain = Terrain(rng.uniform(-0.03, 0.03), rng.uniform(-0.012, 0.012), waves)
    half_road_m = rng.uniform(4.2, 6.0)
    sides = [_StreetSide(terrain, yaw, half_road_m, half_road_m + rng.uniform(2.0, 5.0)) for yaw in (0.0, np.pi)]
    road = terrain.surface(np.linspace(-_REACH_M, _REACH_M, 56), np.array([-half_road_m, 0.0, half_road_m]))
    parts = [road]
    for side in sides:
        parts += [*_pavement(side), *_houses(rng, side), *_parked_cars(rng, side), *_furniture(rng, side)]
    lane_y_m = rng.uniform(-1.0, 1.0) * (half_road_m - 3.4)
    yaw_rad = float(rng.choice([0.0, np.pi])) + rng.normal(scale=0.06)
    return Scene(tuple(parts), terrain, (rng.uniform(-3.0, 3.0), lane_y_m), yaw_rad)


def _pavement(side: _StreetSide) -> list[Mesh]:
    kerb_m, front_m = side.kerb_y_m, side.front_y_m
    profile = [[kerb_m, 0.0], [kerb_m + 0.02, _KERB_M], [front_m, _KERB_M + 0.04], [front_m + 40.0, _KERB_M + 0.05]]
    starts = np.arange(-_REACH_M, _REACH_M, 4.0)
    return [side.drape(extrusion(profile, x, x + 4.0)) for x in starts]


def _houses(rng: np.random.Generator, side: _StreetSide) -> list[Mesh]:
    houses = []
    x_m = -_REACH_M + rng.uniform(0.0, 10.0)
    while x_m < _REACH_M:
        width_m, depth_m = rng.uniform(7.0, 20.0), rng.uniform(8.0, 13.0)
        setback_m = rng.choice([0.0, 0.0, 0.3, 1.2, 3.0]) * rng.uniform(0.5, 1.0)
        houses.append(side.place(building(rng, width_m, depth_m), x_m, side.front_y_m + setback_m, 0.1))
        x_m += width_m + float(rng.choice([0.0, 0.0, 0.0, 2.5, 7.0, 11.0]))
    far_m = side.front_y_m + rng.uniform(25.0, 40.0)
    backs = [side.place(building(rng, 24.0, 8.0), x, far_m) for x in np.arange(-72.0, 72.0, 24.0)]
    return houses + backs


def _parked_cars(rng: np.random.Generator, side: _StreetSide) -> list[Mesh]:
    """Park cars at the kerb, not quite in line."""
    share = rng.uniform(0.2, 0.75)
    taken_x_m = [x for x in np.arange(-60.0, 60.0, 6.0) if rng.random() < share]
    cars = []
    for x_m in taken_x_m:
        y_m = side.kerb_y_m - 1.1 - abs(rng.normal(scale=0.08))
        car = random_car(rng).moved(yaw_rad=rng.normal(scale=0.02))
        cars.append(side.place(car, x_m + rng.normal(scale=0.3), y_m))
    return cars


def _furniture(rng: np.random.Generator, side: _StreetSide) -> list[Mesh]:
    """Place lamp posts at even distances, and trees, signs, bins and benches at random."""
    edge_m, pitch_m = side.kerb_y_m + 0.5, rng.uniform(18.0, 30.0)
    lamps_x_m = np.arange(-70.0 + rng.uniform(0.0, pitch_m), 70.0, pitch_m)
    lamps = [side.place(lamp_post(rng.uniform(5.0, 8.0), 1.2).moved(yaw_rad=-np.pi / 2), x, edge_m) for x in lamps_x_m]
    trees = [side.place(tree(rng, rng.uniform(4.5, 10.0)), x, edge_m + 0.2) for x in _spots(rng, 60.0, (3, 9))]
    signs = [side.place(sign(rng), x, edge_m) for x in _spots(rng, 45.0, (3, 7))]
    things = [refuse_bin(rng) if rng.random() < 0.6 else bench() for _ in range(int(rng.integers(2, 8)))]
    litter = [side.place(thing, rng.uniform(-40.0, 40.0), side.front_y_m - 0.5, _KERB_M) for thing in things]
    return [*lamps, *trees, *signs, *litter]


def _spots(rng: np.random.Generator, reach_m: float, counts: tuple[int, int]) -> list[float]:
    """Draw positions along the street; their number lies between the two counts."""
    count = int(rng.integers(counts[0], counts[1] + 1))
    return [float(x) for x in rng.uniform(-reach_m, reach_m, size=count)]


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
    return Scene(tuple(parts), terrain, (rng.uniform(-8.0, 8.0), rng.uniform(-0.8, 0.8)), yaw_rad)


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
