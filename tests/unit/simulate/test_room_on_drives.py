# SPDX-License-Identifier: Apache-2.0
"""Bodies beside a drive keep free what others use: the way of the vehicle, the truck, and lanes with traffic."""

from __future__ import annotations

import numpy as np
import pytest

from multilica.errors import UsageError
from multilica.simulate import RIGS, drives, simulate_drive
from multilica.simulate.drives import _parked_cars
from multilica.simulate.routes import Place, pose_at
from multilica.simulate.scenes import SCENES
from multilica.simulate.shapes.mesh import Mesh, reaches_into
from multilica.simulate.world import World, random_stream

RIG = RIGS["front_back"]
POSES = {mount.name: mount.T_base_lidar for mount in RIG.mounts}


def world_of(name: str, *disturbances: str, way_m: float = 0.0) -> tuple[World, list[Place]]:
    """A world of seed 0 with a straight way ahead, and its places."""
    scene = SCENES[name](random_stream(name, 0))
    x_m, y_m = scene.vehicle_xy_m
    yaw_rad = scene.vehicle_yaw_rad
    along = np.cos(yaw_rad), np.sin(yaw_rad)
    places = [(x_m + m * along[0], y_m + m * along[1], yaw_rad) for m in np.arange(0.0, way_m + 0.1, 1.0).tolist()]
    way = [pose_at(scene, place) for place in places]
    return World(RIG, scene, (name, 0), POSES, disturbances, way=way), places


def places_in_way(mesh: Mesh, world: World) -> int:
    """How many places of the way a body reaches into."""
    return sum(reaches_into(mesh.transformed(pose.inverse()), *RIG.room_m) for pose in world.way)


def test_a_truck_leaves_the_way_of_a_drive_free() -> None:
    (stays, _), (drives_on, _) = (world_of("street", "truck", way_m=way_m) for way_m in (0.0, 12.0))
    assert places_in_way(_truck_of(drives_on), drives_on) == 0
    assert places_in_way(_truck_of(stays), drives_on) > 0


def _truck_of(world: World) -> Mesh:
    """The truck, which is the last of the obstacles."""
    start = sum(len(part.vertices_m) for part in world.scene.parts)
    corners = world.obstacles.triangles
    whole = corners[(corners >= start).all(axis=1)]
    return Mesh(world.obstacles.vertices_m[start:], whole - start)


@pytest.mark.slow
def test_a_truck_without_a_place_is_refused() -> None:
    scene = SCENES["open_field"](random_stream("open_field", 0))
    way = [pose_at(scene, (x_m, y_m, 0.0)) for x_m in range(-15, 16, 5) for y_m in range(-15, 16, 2)]
    with pytest.raises(UsageError, match="no place beside the vehicle that the drive leaves free"):
        World(RIG, scene, ("open_field", 0), POSES, ("truck",), way=way)


@pytest.mark.slow
def test_a_drive_hands_its_way_to_the_world(monkeypatch: pytest.MonkeyPatch) -> None:
    worlds: list[World] = []
    monkeypatch.setattr(drives, "World", lambda *args, **more: worlds.append(World(*args, **more)) or worlds[-1])
    simulate_drive("front_back", "open_field", 0, route="straight", stops=2, frames=1, keep_every=100, sensors="ideal")
    assert len(worlds[0].way) > 5


def test_parked_cars_keep_the_truck_free() -> None:
    world, places = world_of("open_field", "truck", way_m=12.0)
    T_base_world = world.scene.T_world_base.inverse()
    corners_m = _truck_of(world).transformed(T_base_world).vertices_m
    cars = [car.transformed(T_base_world) for car in _cars(world, places, set())]
    assert not any(reaches_into(car, corners_m.min(axis=0), corners_m.max(axis=0)) for car in cars)


def test_parked_cars_keep_lanes_with_traffic_free() -> None:
    world, places = world_of("motorway", way_m=12.0)
    own_m = world.scene.vehicle_xy_m[1]
    lanes_m = {lane_m for lane_m, _ in world.scene.lanes if abs(lane_m - own_m) > 1.8}
    assert not _reaching(_cars(world, places, lanes_m), lanes_m)
    assert _reaching(_cars(world, places, set()), lanes_m)


def _cars(world: World, places: list[Place], lanes_m: set[float]) -> list[Mesh]:
    return [car for car, _, _ in _parked_cars(world, places, lanes_m, 8, random_stream("cars"))]


def _reaching(cars: list[Mesh], lanes_m: set[float]) -> list[Mesh]:
    """Those that reach into the way of a car on one of the lanes."""
    at_m = [(lane_m, car, car.vertices_m[:, 1]) for car in cars for lane_m in lanes_m]
    return [car for lane_m, car, y_m in at_m if y_m.min() < lane_m + 0.9 and y_m.max() > lane_m - 0.9]


def test_a_place_without_room_for_cars_ends_the_search_early(monkeypatch: pytest.MonkeyPatch) -> None:
    world, places = world_of("motorway")
    tries: list[None] = []
    monkeypatch.setattr(drives, "_is_visible", lambda *_: tries.append(None))
    with pytest.raises(UsageError, match="Found room for 0 parked cars beside the route, expected 500"):
        _parked_cars(world, places, (), 500, random_stream("cars"))
    assert len(tries) == 400
