# SPDX-License-Identifier: Apache-2.0
"""Straight roads along x on which equal things stand at equal distances; the vehicle heads along x."""

import numpy as np

from multilica.simulate.scenes.scene import Scene, Terrain
from multilica.simulate.shapes.mesh import Mesh, extrusion
from multilica.simulate.shapes.objects import bench, bush, lamp_post, sign, tree, truck
from multilica.simulate.shapes.roadside import gantry, guard_rail, noise_wall, railing

_LANE_M = 3.6
_MEDIAN_M = 1.8
_HALF_ROAD_M = 4.2
_MOTORWAY_REACH_M, _BRIDGE_REACH_M, _AVENUE_REACH_M = 200.0, 120.0, 120.0
_KERB_M = 0.14
EXIT_LEG_M, EXIT_BEND_RAD = 12.0, -0.35
"""Arc from stop to stop along an exit, and its turn."""
_EXIT_PIECE_M, _EXIT_REACH_M = 6.0, 110.0
TWO_LANES = ((-1.9, 1.0), (1.9, -1.0))
_YAW_SIGMA_RAD = 0.015


def motorway(rng: np.random.Generator) -> Scene:
    """Build a motorway with rails on equal posts, a gantry and a lorry ahead, and a wall on one side or none."""
    terrain = Terrain(rng.uniform(-0.03, 0.03), rng.uniform(-0.02, 0.02))
    middles_m = _MEDIAN_M + _LANE_M * (np.arange(rng.integers(2, 4)) + 0.5)
    edge_m = float(middles_m[-1]) + _LANE_M / 2.0 + rng.uniform(1.0, 3.0)
    rails = [
        guard_rail(_MOTORWAY_REACH_M, rng.uniform(0.0, 4.0)).moved(0.0, y_m, 0.0, yaw_rad)
        for y_m, yaw_rad in ((-edge_m - 0.3, 0.0), (-0.6, np.pi), (0.6, 0.0), (edge_m + 0.3, np.pi))
    ]
    across_m = np.array([-edge_m - 40.0, edge_m + 40.0])
    parts = [terrain.surface(np.array([-_MOTORWAY_REACH_M, _MOTORWAY_REACH_M]), across_m)]
    parts += [terrain.drape(rail) for rail in rails]
    wall_side = int(rng.integers(-1, 2))
    if wall_side:
        wall = noise_wall(_MOTORWAY_REACH_M, rng.uniform(2.5, 5.0), rng.uniform(0.0, 5.0))
        parts.append(terrain.drape(wall.moved(0.0, wall_side * (edge_m + rng.uniform(1.5, 3.0)))))
    own_y_m = -float(rng.choice(middles_m))
    parts.append(terrain.place(gantry(rng, -edge_m - 1.0, 0.0), rng.uniform(25.0, 60.0), 0.0))
    parts.append(terrain.place(truck(rng.uniform(10.0, 14.0), 3.9), rng.uniform(22.0, 45.0), own_y_m))
    parts.append(terrain.place(sign(rng), rng.uniform(-30.0, 40.0), -edge_m - 1.0))
    lanes = [(sense * -float(y_m), sense) for sense in (1.0, -1.0) for y_m in middles_m]
    stand = (rng.uniform(-2.0, 2.0), own_y_m + rng.normal(scale=0.15))
    return Scene(tuple(parts), terrain, stand, rng.normal(scale=_YAW_SIGMA_RAD), lanes=tuple(lanes))


def motorway_exit(rng: np.random.Generator) -> Scene:
    """Build the right lane of a motorway where a curved exit leaves it, with rails, signs and bushes beside it."""
    terrain = Terrain(rng.uniform(-0.02, 0.02), rng.uniform(-0.02, 0.02))
    middles_m = _MEDIAN_M + _LANE_M * (np.arange(2) + 0.5)
    edge_m = float(middles_m[-1]) + _LANE_M / 2.0 + rng.uniform(1.0, 2.0)
    ground_m = np.array([-_MOTORWAY_REACH_M, _MOTORWAY_REACH_M])
    parts = [terrain.surface(ground_m, np.array([-_EXIT_REACH_M, edge_m + 40.0]))]
    for y_m, yaw_rad in ((-0.6, np.pi), (0.6, 0.0), (edge_m + 0.3, np.pi)):
        parts.append(terrain.drape(guard_rail(_MOTORWAY_REACH_M, rng.uniform(0.0, 4.0)).moved(0.0, y_m, 0.0, yaw_rad)))
    for start_m, end_m in ((-90.0, -12.0), (30.0, 120.0)):
        rail = guard_rail((end_m - start_m) / 2.0, 1.0)
        parts.append(terrain.drape(rail.moved((start_m + end_m) / 2.0, -edge_m - 0.3)))
    own_y_m = -float(middles_m[-1])
    heading_rad, at_m = EXIT_BEND_RAD / 2.0, np.array([-4.0, own_y_m])
    for _ in range(9):
        ahead, right = (np.array([np.cos(a), np.sin(a)]) for a in (heading_rad, heading_rad - np.pi / 2.0))
        middle_m = at_m + _EXIT_PIECE_M / 2.0 * ahead
        for side in (-1.0, 1.0):
            x_m, y_m = (middle_m + side * rng.uniform(4.0, 4.5) * right).tolist()
            if abs(y_m) > edge_m + 0.3:
                parts.append(terrain.place(guard_rail(_EXIT_PIECE_M / 2.0, 1.0), x_m, y_m, heading_rad))
            x_m, y_m = (middle_m + side * rng.uniform(7.0, 16.0) * right).tolist()
            if y_m < -edge_m - 2.0:
                plant = bush(rng, rng.uniform(0.6, 1.6)) if rng.random() < 0.6 else tree(rng, rng.uniform(4.0, 9.0))
                parts.append(terrain.place(plant, x_m, y_m))
        at_m, heading_rad = at_m + _EXIT_PIECE_M * ahead, heading_rad + EXIT_BEND_RAD * _EXIT_PIECE_M / EXIT_LEG_M
    parts.append(terrain.place(gantry(rng, -edge_m - 1.0, 0.0), rng.uniform(22.0, 45.0), 0.0))
    parts += [terrain.place(sign(rng), x_m, -edge_m - 1.0) for x_m in rng.uniform(-40.0, -10.0, size=2).tolist()]
    parts.append(terrain.place(truck(rng.uniform(10.0, 14.0), 3.9), rng.uniform(35.0, 60.0), own_y_m))
    lanes = [(sense * -float(y_m), sense) for sense in (1.0, -1.0) for y_m in middles_m]
    return Scene(tuple(parts), terrain, (0.0, own_y_m), rng.normal(scale=_YAW_SIGMA_RAD), lanes=tuple(lanes))


def bridge(rng: np.random.Generator) -> Scene:
    """Build a bridge with railings of equal balusters, joints and pairs of lamp posts, over land or over water."""
    terrain = Terrain(rng.uniform(-0.015, 0.015))
    half_m = _HALF_ROAD_M + rng.uniform(1.6, 2.6)
    kerb = [[_HALF_ROAD_M, 0.0], [_HALF_ROAD_M, _KERB_M], [half_m, _KERB_M], [half_m, -1.2]]
    profile = np.array([[-y, z] for y, z in reversed(kerb)] + kerb)
    pitch_m, joint_m = rng.uniform(15.0, 30.0), rng.uniform(0.06, 0.14)
    starts_m = np.arange(-_BRIDGE_REACH_M + rng.uniform(-pitch_m, 0.0), _BRIDGE_REACH_M, pitch_m)
    parts = [terrain.drape(extrusion(profile, x, x + pitch_m - joint_m)) for x in starts_m]
    rail = railing(_BRIDGE_REACH_M, rng.uniform(0.11, 0.15))
    parts += [terrain.drape(rail.moved(0.0, side * (half_m - 0.1), _KERB_M)) for side in (-1.0, 1.0)]
    lamp, lamps_m = lamp_post(rng.uniform(6.0, 9.0), 1.2), rng.uniform(18.0, 30.0)
    spots_m = np.arange(-_BRIDGE_REACH_M + rng.uniform(0.0, lamps_m), _BRIDGE_REACH_M, lamps_m)
    parts += _on_both_sides(terrain, lamp.moved(yaw_rad=np.pi / 2.0), spots_m, _HALF_ROAD_M + 0.4)
    if rng.random() < 0.5:
        edges_m = np.array([-200.0, 200.0])
        parts.append(terrain.surface(edges_m, edges_m).moved(z_m=-rng.uniform(6.0, 20.0)))
    return _two_lane_scene(rng, parts, terrain)


def avenue(rng: np.random.Generator) -> Scene:
    """Build a long avenue of equal trees at equal distances; by seed a bench and a sign stand among them."""
    terrain = Terrain(rng.uniform(-0.03, 0.03))
    kerb = [[_HALF_ROAD_M, 0.0], [_HALF_ROAD_M, _KERB_M], [60.0, _KERB_M]]
    profile = np.array([[-y, z] for y, z in reversed(kerb)] + kerb)
    parts = [terrain.drape(extrusion(profile, -_AVENUE_REACH_M, _AVENUE_REACH_M))]
    pitch_m, trunk_y_m = rng.uniform(7.0, 12.0), _HALF_ROAD_M + rng.uniform(1.5, 2.5)
    spots_m = np.arange(-_AVENUE_REACH_M + rng.uniform(0.0, pitch_m), _AVENUE_REACH_M, pitch_m)
    parts += _on_both_sides(terrain, tree(rng, rng.uniform(8.0, 12.0)), spots_m, trunk_y_m)
    if rng.random() < 0.5:
        for thing in (bench(), sign(rng)):
            side = float(rng.choice([-1.0, 1.0]))
            parts.append(terrain.place(thing, rng.uniform(-25.0, 25.0), side * (trunk_y_m + 1.0), 0.0, -_KERB_M))
    return _two_lane_scene(rng, parts, terrain)


def _on_both_sides(terrain: Terrain, mesh: Mesh, spots_x_m: np.ndarray, y_m: float) -> list[Mesh]:
    """Place equal meshes opposite each other, built for the side with y < 0, on the kerb."""
    return [
        terrain.place(mesh, x, side * y_m, (side + 1.0) * np.pi / 2.0, -_KERB_M)
        for x in spots_x_m.tolist()
        for side in (-1.0, 1.0)
    ]


def _two_lane_scene(rng: np.random.Generator, parts: list[Mesh], terrain: Terrain) -> Scene:
    """Let the vehicle stand in the right one of two lanes."""
    stand = (rng.uniform(-3.0, 3.0), TWO_LANES[0][0] + rng.normal(scale=0.15))
    return Scene(tuple(parts), terrain, stand, rng.normal(scale=_YAW_SIGMA_RAD), lanes=TWO_LANES)
