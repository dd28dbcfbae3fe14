# SPDX-License-Identifier: Apache-2.0
"""Scenes below ground."""

import numpy as np

from multilica.simulate.scenes.roads import TWO_LANES
from multilica.simulate.scenes.scene import FLAT, Scene
from multilica.simulate.shapes.mesh import Mesh, box, cylinder, extrusion, merged, quads, tube
from multilica.simulate.shapes.objects import random_car

_TUNNEL_HALF_LENGTH_M, _NICHES_REACH_M = 250.0, 125.0
_NICHE_HEIGHT_M = 2.2


class _GarageFrame:
    """A random frame of columns, symmetric under half a turn about the origin; the middle row of bays is the aisle."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.beam_m = rng.uniform(0.2, 0.45)
        self.bays_x, self.bays_y = int(rng.integers(5, 9)), int(rng.choice([3, 5]))
        self.bay_x_m, self.bay_y_m = rng.uniform(5.0, 8.2), rng.uniform(6.2, 8.0)
        self.half_x_m, self.half_y_m = self.bays_x * self.bay_x_m / 2.0, self.bays_y * self.bay_y_m / 2.0
        self.height_m = 2.7 + self.beam_m + rng.uniform(0.0, 0.4)
        self.column_m, self.round = rng.uniform(0.35, 0.7), bool(rng.random() < 0.3)

    @property
    def slots(self) -> list[tuple[float, float, float]]:
        """Return (x, y, yaw) of the parking slots in the rows with y < 0."""
        columns_x = np.arange(-self.half_x_m + 1.6, self.half_x_m - 1.0, 2.6)
        rows_y = [-self.bay_y_m * (0.5 + row) - 2.7 for row in range(self.bays_y // 2)]
        return [(float(x), float(y), np.pi / 2.0) for y in rows_y for x in columns_x]


def _structure(frame: _GarageFrame) -> list[Mesh]:
    """Build floor, ceiling, outer walls, columns and beams."""
    x, y, z = frame.half_x_m, frame.half_y_m, frame.height_m
    shell = box((-x, -y, 0.0), (x, y, z))
    lines_x = np.arange(1, frame.bays_x) * frame.bay_x_m - x
    lines_y = np.arange(1, frame.bays_y) * frame.bay_y_m - y
    half = frame.column_m / 2.0
    column = cylinder(half, 0.0, z, sides=16) if frame.round else box((-half, -half, 0.0), (half, half, z))
    columns = [column.moved(cx, cy) for cx in lines_x for cy in lines_y]
    beams = [box((bx - half, -y, z - frame.beam_m), (bx + half, y, z)) for bx in lines_x]
    pilasters = [box((px - half, s * y - 0.2, 0.0), (px + half, s * y + 0.2, z)) for px in lines_x for s in (-1.0, 1.0)]
    return [shell, *columns, *beams, *pilasters]


def _half_cars(rng: np.random.Generator, frame: _GarageFrame, occupancy: float) -> list[Mesh]:
    """Park cars in the slots with y < 0 that no column stands in."""
    cars = []
    for x_m, y_m, yaw_rad in frame.slots:
        phase_m = (x_m + frame.half_x_m) % frame.bay_x_m
        if rng.random() < occupancy and min(phase_m, frame.bay_x_m - phase_m) >= 1.3:
            jitter = rng.normal(scale=[0.1, 0.2, 0.03])
            cars.append(random_car(rng).moved(x_m + jitter[0], y_m + jitter[1], 0.0, yaw_rad + jitter[2]))
    return cars


def garage(rng: np.random.Generator) -> Scene:
    """Build a garage whose ends differ only in cars, pipes, walls and the ramp."""
    frame = _GarageFrame(rng)
    occupancy = rng.uniform(0.25, 0.7)
    cars = _half_cars(rng, frame, occupancy)
    cars += [mesh.moved(yaw_rad=np.pi) for mesh in _half_cars(rng, frame, occupancy)]
    fittings = [*_pipes(rng, frame), *_rooms(rng, frame), _ramp(rng, frame)]
    yaw_rad = float(rng.choice([0.0, np.pi])) + rng.normal(scale=0.08)
    stand = (rng.uniform(-1.5, 1.5), rng.uniform(-0.6, 0.6))
    headroom_m = frame.height_m - frame.beam_m - 0.1
    return Scene((*_structure(frame), *cars, *fittings), FLAT, stand, yaw_rad, headroom_m)


def _pipes(rng: np.random.Generator, frame: _GarageFrame) -> list[Mesh]:
    """Build pipes under the ceiling, a duct across and drains at the walls."""
    runs = []
    for _ in range(int(rng.integers(2, 6))):
        y_m, z_m = rng.uniform(-0.9, 0.9) * frame.half_y_m, frame.height_m - frame.beam_m - 0.15
        radius_m = rng.uniform(0.04, 0.14)
        start_m = rng.uniform(-1.0, 0.2) * frame.half_x_m
        runs.append(tube((start_m, y_m, z_m), (frame.half_x_m, y_m, z_m), radius_m))
    x_m, low_m = rng.uniform(-0.7, 0.7) * frame.half_x_m, frame.height_m - frame.beam_m - 0.3
    duct = box((x_m, -frame.half_y_m, low_m), (x_m + 0.7, rng.uniform(-0.2, 1.0) * frame.half_y_m, low_m + 0.3))
    drains_x_m = rng.uniform(-0.9, 0.9, 3) * frame.half_x_m
    drains_y_m = rng.choice([-1.0, 1.0], 3) * (frame.half_y_m - 0.12)
    corners = zip(drains_x_m, drains_y_m, strict=True)
    drains = [tube((x, y, 0.0), (x, y, frame.height_m), 0.06) for x, y in corners]
    return [*runs, duct, *drains]


def _rooms(rng: np.random.Generator, frame: _GarageFrame) -> list[Mesh]:
    """Build a stair core at one side, a plant room in a corner and a partition between two columns."""
    y, z = frame.half_y_m, frame.height_m
    core_x_m, core_w_m = rng.uniform(-0.6, 0.3) * frame.half_x_m, rng.uniform(2.5, 5.0)
    side = float(rng.choice([-1.0, 1.0]))
    core = _between((core_x_m, side * (y - 2.4), 0.0), (core_x_m + core_w_m, side * y, z))
    corner_x_m = float(rng.choice([-1.0, 1.0])) * frame.half_x_m
    plant = _between((corner_x_m, -side * (y - 3.5), 0.0), (corner_x_m - np.sign(corner_x_m) * 4.0, -side * y, z))
    line_y_m = side * frame.bay_y_m * 0.5
    first_x_m = -frame.half_x_m + frame.bay_x_m * int(rng.integers(0, frame.bays_x))
    partition = box((first_x_m, line_y_m - 0.1, 0.0), (first_x_m + frame.bay_x_m, line_y_m + 0.1, z))
    return [core, plant, partition]


def _between(a_m: tuple[float, float, float], b_m: tuple[float, float, float]) -> Mesh:
    pairs = [sorted(pair) for pair in zip(a_m, b_m, strict=True)]
    return box([low for low, _ in pairs], [high for _, high in pairs])


def _ramp(rng: np.random.Generator, frame: _GarageFrame) -> Mesh:
    """Build a ramp that rises along an outer wall towards one end."""
    end = float(rng.choice([-1.0, 1.0]))
    x0, x1 = end * (frame.half_x_m - 11.0), end * frame.half_x_m
    y0, y1 = frame.half_y_m - 4.5, frame.half_y_m
    z_m = 0.55 * frame.height_m
    deck = [[x0, y0, 0.0], [x1, y0, z_m], [x1, y1, z_m], [x0, y1, 0.0]]
    cheek = [[x0, y0, 0.0], [x1, y0, 0.0], [x1, y0, z_m + 0.9], [x0, y0, 0.9]]
    return quads([deck, cheek])


def symmetric_garage(rng: np.random.Generator) -> Scene:
    """Build a garage that is exactly the same after half a turn about the vehicle."""
    frame = _GarageFrame(rng)
    half = _half_cars(rng, frame, rng.uniform(0.25, 0.7))
    x_m, z_m = frame.half_x_m, frame.height_m - 0.2
    half += [tube((-x_m, y, z_m), (x_m, y, z_m), 0.08) for y in rng.uniform(0.1, 0.9, 2) * frame.half_y_m]
    yaw_rad = float(rng.choice([0.0, np.pi])) + rng.normal(scale=0.08)
    headroom_m = frame.height_m - frame.beam_m - 0.1
    turned = [mesh.moved(yaw_rad=np.pi) for mesh in half]
    return Scene((*_structure(frame), *half, *turned), FLAT, (0.0, 0.0), yaw_rad, headroom_m)


class _Bore:
    """Random sizes of a vault over a road with walkways; the distance of its walls from the middle is in a range."""

    def __init__(self, rng: np.random.Generator, half_m: tuple[float, float]) -> None:
        self.half_m, self.wall_m = rng.uniform(*half_m), rng.uniform(2.5, 4.0)
        self.walkway_m, self.kerb_m = rng.uniform(0.8, 1.3, size=2), rng.uniform(0.15, 0.3)
        self.rise_m = rng.uniform(0.6, 1.0) * self.half_m

    def walls(self, x0_m: float, x1_m: float, niches_m: tuple[float, float] = (0.0, 0.0)) -> Mesh:
        """Build a piece of the tunnel, its right and left walls set back by the depth of a niche."""
        half_m, kerb_m, walkway_m = self.half_m, self.kerb_m, self.walkway_m
        angles = np.linspace(0.0, np.pi, 25)
        vault = np.column_stack([half_m * np.cos(angles), self.wall_m + self.rise_m * np.sin(angles)])
        right = [[-half_m, kerb_m], [-half_m + walkway_m[0], kerb_m], [-half_m + walkway_m[0], 0.0]]
        left = [[half_m - walkway_m[1], 0.0], [half_m - walkway_m[1], kerb_m], [half_m, kerb_m]]
        pockets = (self._pocket(-half_m, -niches_m[0]), self._pocket(half_m, niches_m[1]))
        profile = [*vault.tolist(), *reversed(pockets[0]), *right, *left, *pockets[1], [half_m, self.wall_m]]
        cheeks = [quads([[[x, *corner] for corner in pocket] for x in (x0_m, x1_m)]) for pocket in pockets if pocket]
        return merged([extrusion(profile, x0_m, x1_m), *cheeks])

    def _pocket(self, wall_y_m: float, depth_m: float) -> list[list[float]]:
        """Return y and z of the corners of a niche from the floor up; none without depth."""
        if not depth_m:
            return []
        back_m, top_m = wall_y_m + depth_m, self.kerb_m + _NICHE_HEIGHT_M
        return [[wall_y_m, self.kerb_m], [back_m, self.kerb_m], [back_m, top_m], [wall_y_m, top_m]]


def tunnel(rng: np.random.Generator) -> Scene:
    """Build a vault over a road with walkways; all cross-sections are equal, so x is not observable."""
    bore = _Bore(rng, (4.5, 6.5))
    yaw_rad = rng.normal(scale=0.04)
    walls = bore.walls(-_TUNNEL_HALF_LENGTH_M, _TUNNEL_HALF_LENGTH_M)
    return Scene((walls,), FLAT, (0.0, rng.uniform(-0.8, 0.8)), yaw_rad, 4.0)


def tunnel_niches(rng: np.random.Generator) -> Scene:
    """Build a tunnel for two lanes with equal niches at equal distances, in one wall or in both."""
    bore = _Bore(rng, (6.0, 7.5))
    depth_m, width_m, pitch_m = rng.uniform(0.4, 1.2), rng.uniform(1.5, 3.0), rng.uniform(8.0, 25.0)
    depths_m = [(depth_m, 0.0), (0.0, depth_m), (depth_m, depth_m)][int(rng.integers(3))]
    first_m = rng.uniform(0.0, pitch_m) - _NICHES_REACH_M
    starts_m = np.arange(first_m, _NICHES_REACH_M, pitch_m).tolist()
    walls = [bore.walls(x, x + width_m, depths_m) for x in starts_m]
    walls += [bore.walls(x + width_m, x + pitch_m) for x in starts_m]
    stand = (rng.uniform(-3.0, 3.0), TWO_LANES[0][0] + rng.normal(scale=0.15))
    return Scene((merged(walls),), FLAT, stand, rng.normal(scale=0.015), 4.0, TWO_LANES)
