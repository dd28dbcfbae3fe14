# SPDX-License-Identifier: Apache-2.0
"""Cars, trucks, pedestrians."""

from dataclasses import dataclass

import numpy as np

from multilica.simulate.shapes.mesh import Mesh, box, cylinder, merged, sphere, tapered_box, tube


@dataclass(frozen=True, slots=True)
class CarShape:
    """Proportions of a car body; the greenhouse has x of rear and front at the belt (`cabin_m`) and at the roof."""

    length_m: float
    width_m: float
    height_m: float
    belt_m: float
    cabin_m: tuple[float, float]
    roof_m: tuple[float, float]


CAR_SHAPES = {
    "saloon": CarShape(4.7, 1.82, 1.45, 0.92, (-1.85, 1.15), (-1.05, 0.30)),
    "hatchback": CarShape(4.0, 1.75, 1.48, 0.92, (-1.90, 1.00), (-1.60, 0.20)),
    "estate": CarShape(4.7, 1.82, 1.48, 0.92, (-2.25, 1.10), (-1.95, 0.25)),
    "suv": CarShape(4.6, 1.90, 1.72, 1.05, (-2.15, 1.05), (-1.85, 0.35)),
    "van": CarShape(5.2, 1.95, 2.05, 1.15, (-2.55, 1.75), (-2.45, 0.95)),
    "pickup": CarShape(5.3, 1.90, 1.80, 1.05, (-0.75, 1.25), (-0.55, 0.45)),
}


def car(shape: CarShape) -> Mesh:
    """Build a car on its wheels, heading along x, its middle over the origin."""
    half_x, half_y = shape.length_m / 2.0, shape.width_m / 2.0
    waist_m = 0.55
    waist = _rectangle(-half_x, half_x, half_y)
    sill = tapered_box(_rectangle(-half_x + 0.10, half_x - 0.15, half_y - 0.08), waist, 0.22, waist_m)
    belt = _rectangle(-half_x + 0.08, half_x - 0.45, half_y - 0.06)
    bonnet = tapered_box(waist, belt, waist_m, shape.belt_m)
    foot, roof = _rectangle(*shape.cabin_m, half_y - 0.07), _rectangle(*shape.roof_m, half_y - 0.24)
    cabin = tapered_box(foot, roof, shape.belt_m, shape.height_m)
    return merged([sill, bonnet, cabin, *_wheels(shape.length_m * 0.29, half_y), *_mirrors(shape, half_y)])


def _rectangle(rear_m: float, front_m: float, half_y_m: float) -> tuple[float, float, float, float]:
    return rear_m, front_m, -half_y_m, half_y_m


def _wheels(axle_m: float, half_y_m: float) -> list[Mesh]:
    return [
        tube((x, side * (half_y_m - 0.22), 0.32), (x, side * half_y_m, 0.32), 0.32, sides=14)
        for x in (-axle_m, axle_m)
        for side in (-1.0, 1.0)
    ]


def _mirrors(shape: CarShape, half_y_m: float) -> list[Mesh]:
    x_m, z_m = shape.cabin_m[1] - 0.45, shape.belt_m + 0.02
    sides_y_m = (side * (half_y_m + 0.07) for side in (-1.0, 1.0))
    return [box((x_m, y_m - 0.1, z_m), (x_m + 0.12, y_m + 0.1, z_m + 0.14)) for y_m in sides_y_m]


def random_car(rng: np.random.Generator) -> Mesh:
    """Build a car of random shape and size, heading along x or against it."""
    shape = CAR_SHAPES[rng.choice(sorted(CAR_SHAPES))]
    body = car(shape)
    scale = rng.normal(1.0, [0.03, 0.02, 0.03]).clip(0.92, 1.08)
    return Mesh(body.vertices_m * scale, body.triangles).moved(yaw_rad=float(rng.choice([0.0, np.pi])))


def truck(length_m: float, height_m: float) -> Mesh:
    """Build a lorry with a box body and a cab, heading along x, its middle over the origin."""
    half_x, half_y = length_m / 2.0, 1.25
    body = box((-half_x, -half_y, 1.0), (half_x - 2.6, half_y, height_m))
    foot, roof = _rectangle(half_x - 2.3, half_x, half_y), _rectangle(half_x - 2.2, half_x - 0.25, half_y - 0.1)
    cab = tapered_box(foot, roof, 0.5, min(height_m, 3.1))
    chassis = box((-half_x + 0.3, -0.5, 0.55), (half_x - 0.4, 0.5, 1.0))
    axles = [-half_x + 1.5, -half_x + 2.8, half_x - 1.4]
    wheels = [tube((x, s * 0.85, 0.5), (x, s * 1.2, 0.5), 0.5, sides=14) for x in axles for s in (-1.0, 1.0)]
    return merged([body, cab, chassis, *wheels])


def pedestrian(height_m: float, stride_rad: float) -> Mesh:
    """Build a person who walks along x, legs and arms apart by the stride angle."""
    hip_m, shoulder_m = 0.5 * height_m, 0.82 * height_m
    reach_m = float(np.tan(stride_rad)) * hip_m
    legs = [tube((s * reach_m, s * 0.1, 0.0), (0.0, s * 0.1, hip_m), 0.08) for s in (-1.0, 1.0)]
    arms = [tube((-s * reach_m * 0.8, s * 0.26, hip_m), (0.0, s * 0.22, shoulder_m), 0.05) for s in (-1.0, 1.0)]
    torso = tapered_box((-0.11, 0.11, -0.16, 0.16), (-0.12, 0.12, -0.22, 0.22), hip_m, shoulder_m)
    head = sphere((0.1, 0.09, 0.13), (0.0, 0.0, height_m - 0.13))
    neck = cylinder(0.06, shoulder_m, height_m - 0.2)
    return merged([*legs, *arms, torso, head, neck])
