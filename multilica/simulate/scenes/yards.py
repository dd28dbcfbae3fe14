# SPDX-License-Identifier: Apache-2.0
"""Yards that look alike in several directions."""

import numpy as np

from multilica.simulate.scenes.scene import FLAT, Scene
from multilica.simulate.shapes.buildings import building
from multilica.simulate.shapes.mesh import Mesh, box, merged, repeated
from multilica.simulate.shapes.objects import lamp_post, random_car, truck

_BAY_M, _BAY_DEPTH_M, _BAYS, _COLUMN_BAYS = 2.5, 5.6, 24, 3
_AISLE_M = 6.5
_YARD_FREE_M = 9.0


def car_park(rng: np.random.Generator) -> Scene:
    """Build equal bays with cars in most, by seed all of one model, by seed under a roof on equal columns."""
    one_model, roofed = rng.random() < 0.5, rng.random() < 0.5
    model, occupancy = random_car(rng), rng.uniform(0.7, 0.95)
    borders_x_m = _BAY_M * (np.arange(_BAYS + 1) - _BAYS / 2.0)
    backs_y_m = _AISLE_M / 2.0 + _BAY_DEPTH_M
    rows_y_m = [backs_y_m - _BAY_DEPTH_M / 2.0, backs_y_m + _BAY_DEPTH_M / 2.0]
    half_x_m, half_y_m = float(borders_x_m[-1]) + 6.0, backs_y_m + _BAY_DEPTH_M + _AISLE_M
    parts: list[Mesh] = []
    for y_m in (-rows_y_m[1], -rows_y_m[0], *rows_y_m):
        for x_m in (borders_x_m[:-1] + _BAY_M / 2.0).tolist():
            if rng.random() < occupancy:
                car = model if one_model else random_car(rng)
                jitter = rng.normal(scale=[0.05, 0.1, 0.015])
                parts.append(car.moved(x_m + jitter[0], y_m + jitter[1], 0.0, np.pi / 2.0 + jitter[2]))
    parts.append(FLAT.surface(np.array([-half_x_m, half_x_m]), np.array([-half_y_m, half_y_m])))
    for sense in (-1.0, 1.0):
        x_m, y_m = sense * half_x_m, sense * half_y_m
        parts.append(box((x_m - 0.1, -half_y_m, 0.0), (x_m + 0.1, half_y_m, 1.1)))
        parts.append(box((-half_x_m, y_m - 0.1, 0.0), (half_x_m, y_m + 0.1, 1.1)))
    headroom_m = 10.0
    if roofed:
        headroom_m = rng.uniform(2.7, 3.0)
        lines_m = (borders_x_m[::_COLUMN_BAYS], (-half_y_m, -backs_y_m, backs_y_m, half_y_m))
        parts += _roof(*lines_m, headroom_m, (half_x_m, half_y_m))
    yaw_rad = float(rng.choice([0.0, np.pi])) + rng.normal(scale=0.03)
    return Scene(tuple(parts), FLAT, (rng.uniform(-8.0, 8.0), rng.uniform(-0.5, 0.5)), yaw_rad, headroom_m)


def _roof(
    lines_x_m: np.ndarray, lines_y_m: tuple[float, ...], headroom_m: float, half_m: tuple[float, float]
) -> list[Mesh]:
    """Build a ceiling with equal beams across on equal columns."""
    half_x_m, half_y_m = half_m
    ceiling = box((-half_x_m, -half_y_m, headroom_m + 0.4), (half_x_m, half_y_m, headroom_m + 0.7))
    beam = box((-0.2, -half_y_m, headroom_m), (0.2, half_y_m, headroom_m + 0.4))
    column = box((-0.2, -0.2, 0.0), (0.2, 0.2, headroom_m))
    return [ceiling, repeated(beam, lines_x_m), *(repeated(column.moved(0.0, y), lines_x_m) for y in lines_y_m)]


def court(rng: np.random.Generator) -> Scene:
    """Build a court with four equal sides: exactly the same after a quarter turn about its middle."""
    side_m = rng.uniform(30.0, 42.0)
    front = building(rng, side_m, 10.0).moved(-side_m / 2.0, side_m / 2.0)
    edges_m = np.array([-side_m, side_m])
    sides = [front.moved(yaw_rad=quarter * np.pi / 2.0) for quarter in range(4)]
    stand = (rng.uniform(-2.5, 2.5), rng.uniform(-2.5, 2.5))
    return Scene((FLAT.surface(edges_m, edges_m), *sides), FLAT, stand, rng.uniform(-np.pi, np.pi))


def yard(rng: np.random.Generator) -> Scene:
    """Build the yard of a works: halls around it, containers, lorries, cars, crates and posts, free in the middle."""
    half_x_m, half_y_m = rng.uniform(22.0, 30.0), rng.uniform(20.0, 26.0)
    edges_m = np.array([-90.0, 90.0])
    parts = [FLAT.surface(edges_m, edges_m)]
    sides = ((half_y_m, half_x_m, 0.0), (half_x_m, half_y_m, np.pi / 2), (half_y_m, half_x_m, np.pi))
    for away_m, half_m, yaw_rad in sides:
        hall_m = rng.uniform(1.0, 1.8) * half_m
        hall = building(rng, hall_m, 12.0).moved(rng.uniform(-half_m, half_m - hall_m), away_m)
        parts.append(hall.moved(yaw_rad=yaw_rad))
    for _ in range(int(rng.integers(14, 22))):
        azimuth_rad, out = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, 1.0)
        ring_m = _YARD_FREE_M + out * (min(half_x_m, half_y_m) - _YARD_FREE_M - 4.0)
        x_m, y_m = ring_m * float(np.cos(azimuth_rad)), ring_m * float(np.sin(azimuth_rad))
        parts.append(_yard_thing(rng).moved(x_m, y_m, 0.0, azimuth_rad + np.pi / 2.0 + rng.normal(scale=0.2)))
    return Scene(tuple(parts), FLAT, (rng.uniform(-3.0, 3.0), rng.uniform(-3.0, 3.0)), rng.uniform(-np.pi, np.pi))


def _yard_thing(rng: np.random.Generator) -> Mesh:
    """Build what stands in a yard, along x."""
    kind = rng.choice(["container", "container", "truck", "car", "car", "crates", "post"])
    if kind == "container":
        half_m = float(rng.choice([3.03, 6.1]))
        return box((-half_m, -1.22, 0.0), (half_m, 1.22, 2.6 * float(rng.choice([1.0, 1.0, 2.0]))))
    if kind == "truck":
        return truck(rng.uniform(8.0, 12.0), 3.6)
    if kind == "car":
        return random_car(rng)
    if kind == "post":
        return lamp_post(rng.uniform(5.0, 8.0), 1.0)
    sizes_m = rng.uniform(0.4, 0.8, size=(int(rng.integers(2, 6)), 3))
    crates = [box((-0.5, -0.4, 0.0), (0.5, 0.4, 2.0 * size[2])).moved(*rng.uniform(-1.5, 1.5, 2)) for size in sizes_m]
    return merged(crates)
