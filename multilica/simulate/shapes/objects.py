# SPDX-License-Identifier: Apache-2.0
"""Vehicles, people, furniture and plants outdoors."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from multilica.geometry import FloatArray
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


@cache
def car(shape: CarShape) -> Mesh:
    """Build a car on its wheels, heading along x, its middle over the origin."""
    half_x, half_y = shape.length_m / 2.0, shape.width_m / 2.0
    waist_m, axle_m = 0.55, shape.length_m * 0.29
    waist = _rectangle(-half_x, half_x, half_y)
    sill = tapered_box(_rectangle(-half_x + 0.10, half_x - 0.15, half_y - 0.08), waist, 0.22, waist_m)
    belt = _rectangle(-half_x + 0.08, half_x - 0.45, half_y - 0.06)
    bonnet = tapered_box(waist, belt, waist_m, shape.belt_m)
    foot, roof = _rectangle(*shape.cabin_m, half_y - 0.07), _rectangle(*shape.roof_m, half_y - 0.24)
    cabin = tapered_box(foot, roof, shape.belt_m, shape.height_m)
    return merged(
        [sill, bonnet, cabin, *wheels((-axle_m, axle_m), half_y - 0.22, half_y, 0.32), *_mirrors(shape, half_y)]
    )


def _rectangle(rear_m: float, front_m: float, half_y_m: float) -> tuple[float, float, float, float]:
    return rear_m, front_m, -half_y_m, half_y_m


def wheels(axles_x_m: Sequence[float], inner_y_m: float, outer_y_m: float, radius_m: float) -> list[Mesh]:
    """Build a wheel at both ends of each axle, standing on the ground."""
    ends = [(x, side) for x in axles_x_m for side in (-1.0, 1.0)]
    return [tube((x, s * inner_y_m, radius_m), (x, s * outer_y_m, radius_m), radius_m, sides=14) for x, s in ends]


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
    axles_x_m = (-half_x + 1.5, -half_x + 2.8, half_x - 1.4)
    return merged([body, cab, chassis, *wheels(axles_x_m, 0.85, 1.2, 0.5)])


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


def lamp_post(height_m: float, arm_m: float) -> Mesh:
    """Build a tapering post whose arm with the lamp reaches along x."""
    post = cylinder(0.09, -0.3, height_m, top_radius_m=0.05)
    arm = tube((0.0, 0.0, height_m - 0.1), (arm_m, 0.0, height_m + 0.2), 0.04)
    lamp = box((arm_m - 0.3, -0.15, height_m + 0.12), (arm_m + 0.4, 0.15, height_m + 0.25))
    foot = cylinder(0.14, -0.3, 0.9)
    return merged([post, arm, lamp, foot])


def sign(rng: np.random.Generator) -> Mesh:
    """Build a traffic sign on its post, its plate across x."""
    height_m, half_m = rng.uniform(2.2, 3.2), rng.uniform(0.25, 0.5)
    plate = box((-0.02, -half_m, height_m - 2.0 * half_m), (0.02, half_m, height_m))
    return merged([cylinder(0.035, -0.3, height_m, sides=8), plate])


def bench() -> Mesh:
    """Build a park bench along x."""
    seat = box((-0.8, -0.22, 0.40), (0.8, 0.22, 0.47))
    back = box((-0.8, 0.20, 0.47), (0.8, 0.26, 0.90))
    legs = [box((x, -0.2, -0.2), (x + 0.08, 0.25, 0.4)) for x in (-0.7, 0.62)]
    return merged([seat, back, *legs])


def refuse_bin(rng: np.random.Generator) -> Mesh:
    """Build a wheeled refuse bin."""
    height_m = rng.uniform(0.95, 1.3)
    half_m = rng.uniform(0.28, 0.6)
    lid = box((-half_m, -0.36, height_m), (half_m, 0.34, height_m + 0.08))
    return merged([box((-half_m, -0.3, 0.08), (half_m, 0.3, height_m)), lid])


def fence(x0_m: float, x1_m: float, height_m: float) -> Mesh:
    """Build a seamless board fence along x: every part of it looks like every other."""
    boards = box((x0_m, -0.02, 0.05), (x1_m, 0.02, height_m))
    rails = [box((x0_m, -0.08, z), (x1_m, -0.02, z + 0.1)) for z in (0.3, height_m - 0.35)]
    return merged([boards, *rails])


def post_fence(rng: np.random.Generator, length_m: float) -> Mesh:
    """Build a pasture fence along x: uneven posts with two rails."""
    even_m = np.arange(0.0, length_m, 2.5)
    spots = even_m + rng.normal(scale=0.15, size=len(even_m))
    posts = [cylinder(0.07, -0.4, rng.uniform(1.1, 1.4), sides=6).moved(x, rng.normal(scale=0.03)) for x in spots]
    rails = [box((0.0, -0.03, z), (length_m, 0.03, z + 0.12)) for z in (0.45, 0.95)]
    return merged([*posts, *rails])


def hay_bale(rng: np.random.Generator) -> Mesh:
    """Build a round bale that lies on its side, axis along y."""
    radius_m, half_m = rng.uniform(0.55, 0.85), rng.uniform(0.5, 0.75)
    return tube((0.0, -half_m, radius_m), (0.0, half_m, radius_m), radius_m, sides=20)


def trolley_shelter(rng: np.random.Generator) -> Mesh:
    """Build a roofed stand for shopping trolleys along x."""
    length_m = rng.uniform(4.0, 7.0)
    posts = [cylinder(0.05, -0.2, 2.3, sides=8).moved(x, y) for x in (0.0, length_m) for y in (-1.0, 1.0)]
    roof = box((-0.3, -1.3, 2.3), (length_m + 0.3, 1.3, 2.38))
    pane = box((0.0, 0.98, 0.2), (length_m, 1.02, 2.0))
    trolleys_x_m = np.arange(0.3, rng.uniform(1.0, length_m - 0.5), 0.45)
    trolleys = [box((x, -0.3, 0.25), (x + 0.35, 0.3, 1.0)) for x in trolleys_x_m]
    return merged([*posts, roof, pane, *trolleys])


def tree(rng: np.random.Generator, height_m: float) -> Mesh:
    """Build a trunk, some branches, and a crown of leaf-sized facets that lets part of the beams through."""
    trunk_top_m = height_m * rng.uniform(0.3, 0.45)
    radius_m = 0.03 * height_m * rng.uniform(0.6, 1.1)
    lean = rng.normal(scale=0.03, size=2)
    trunk = cylinder(radius_m, -0.3, height_m * 0.75, top_radius_m=0.3 * radius_m)
    crown_m = np.array([0.28, 0.28, 0.34]) * height_m * rng.uniform(0.75, 1.2, size=3)
    centre = np.array([0.0, 0.0, height_m - crown_m[2]])
    ends = centre + rng.uniform(-0.7, 0.7, size=(5, 3)) * crown_m
    branches = [tube((0.0, 0.0, trunk_top_m), end, 0.25 * radius_m, sides=5) for end in ends.tolist()]
    leaves = _facets(_crown_points(rng, 420, crown_m) + centre, 0.16, rng)
    return merged([trunk, *branches, leaves]).rotated((lean[0], lean[1], rng.uniform(0.0, 2.0 * np.pi)))


def _crown_points(rng: np.random.Generator, count: int, radii_m: FloatArray) -> FloatArray:
    """Draw points in an ellipsoid with lumps, denser near its surface."""
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    lumps = rng.normal(size=(6, 3))
    shells = 0.75 + 0.25 * np.tanh(directions @ lumps.T).max(axis=1)
    return np.asarray(directions * (shells * rng.uniform(0.35, 1.0, size=count))[:, None] * radii_m)


def bush(rng: np.random.Generator, radius_m: float) -> Mesh:
    """Build a low dome of facets."""
    radii = radius_m * rng.uniform(0.7, 1.2, size=3)
    points = _crown_points(rng, 160, radii)
    points[:, 2] = np.abs(points[:, 2])
    return _facets(points, 0.1 + 0.04 * radius_m, rng)


def hedge(rng: np.random.Generator, length_m: float, height_m: float) -> Mesh:
    """Build a trimmed hedge along x from the origin, rough on all sides."""
    width_m = 0.9
    core = box((0.0, -width_m / 2.0 + 0.12, 0.0), (length_m, width_m / 2.0 - 0.12, height_m - 0.12))
    count = int(70 * length_m * height_m)
    points = rng.uniform([0.0, -0.5, 0.0], [length_m, 0.5, height_m], size=(count, 3))
    on_top = rng.random(count) < width_m / (width_m + 2.0 * height_m)
    points[:, 1] = np.where(on_top, points[:, 1] * width_m, np.copysign(width_m / 2.0, points[:, 1]))
    points[on_top, 2] = height_m
    return merged([core, _facets(points, 0.08, rng)])


def _facets(centres_m: FloatArray, size_m: float, rng: np.random.Generator) -> Mesh:
    """Build a triangle of random attitude at each centre (N, 3): leaves, grass."""
    corners = centres_m[:, None, :] + rng.normal(scale=size_m, size=(len(centres_m), 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * len(centres_m)).reshape(-1, 3))
