# SPDX-License-Identifier: Apache-2.0
"""Yards that look alike in several directions."""

import numpy as np

from multilica.simulate.scenes.scene import FLAT, Scene
from multilica.simulate.shapes.buildings import building
from multilica.simulate.shapes.mesh import Mesh, box, repeated
from multilica.simulate.shapes.objects import random_car

_BAY_M, _BAY_DEPTH_M, _BAYS, _COLUMN_BAYS = 2.5, 5.6, 24, 3
_AISLE_M = 6.5


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
