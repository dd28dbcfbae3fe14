# SPDX-License-Identifier: Apache-2.0
"""Simulation of one vehicle that stands at several places of a scene, and drives in between."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np

from multilica.errors import UsageError, listed
from multilica.extrinsics import Extrinsics, pose_values
from multilica.geometry import RigidTransform
from multilica.simulate.rigs import BASE, Mount
from multilica.simulate.routes import (
    PASSABLE_ROUTES,
    Leg,
    Place,
    places_of,
    plan_legs,
    pose_at,
    standing_at,
    sweep,
    with_room_along,
)
from multilica.simulate.scenes import SCENES, Scene
from multilica.simulate.sensors import unit_directions
from multilica.simulate.shapes.mesh import Mesh, merged, reaches_into
from multilica.simulate.shapes.objects import random_car
from multilica.simulate.simulation import (
    FIRST_STAMP_NS,
    Sensors,
    Vehicle,
    draw_vehicle,
    thinned_scans,
    topic_of,
    with_motions,
)
from multilica.simulate.world import FRAME_S, WAY_SHARES, Exposure, World, random_stream
from multilica.snapshot import LidarScans, Snapshot

FIRST_STOP = "first_stop"
"""Frame of the vehicle's poses: its base frame at the first stop."""
_LEG_FRAMES = 30
_UNMOVED: Mapping[str, RigidTransform] = MappingProxyType({})
_CAR_LOW_M, _CAR_HIGH_M = np.array([-2.8, -1.1, 0.4]), np.array([2.8, 1.1, 2.0])
_CAR_NEAR_M, _CAR_FAR_M = 3.5, 14.0
_EYE_M = 1.1
_CAR_TRIES, _CAR_FAILURES = 40, 400
"""Tries per car that is asked for, and failures in a row that end them."""


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedDrive:
    """A vehicle at several stops of a drive.

    Args:
        snapshots: one per stop.
        truths: exact ``T_base_<lidar>`` at each stop; they differ only if a LiDAR moved in between.
        T_first_stop_base: exact poses of the vehicle at the stops, in its base frame at the first one.
        spans_ns: stamps of the first and the last frame at each stop.
        log: all frames of the drive, also those on the way, which lie in the order of time; None without.
    """

    snapshots: tuple[Snapshot, ...]
    truths: tuple[Extrinsics, ...]
    T_first_stop_base: tuple[RigidTransform, ...]
    spans_ns: tuple[tuple[int, int], ...]
    log: Snapshot | None = None

    @property
    def truth(self) -> Extrinsics:
        """Exact ``T_base_<lidar>`` at the first stop."""
        return self.truths[0]

    def stops_table(self) -> list[dict[str, Any]]:
        """Return times and poses of the stops as values for TOML."""
        stops = zip(self.spans_ns, self.T_first_stop_base, strict=True)
        return [
            {"first_stamp_ns": first_ns, "last_stamp_ns": last_ns, **pose_values(pose)}
            for (first_ns, last_ns), pose in stops
        ]


def simulate_drive(
    rig: str,
    scene: str,
    seed: int,
    *,
    route: str = "turning",
    stops: int = 4,
    frames: int = 5,
    step_m: float | None = None,
    disturbances: tuple[str, ...] = (),
    parked: int = 0,
    build_seed: int | None = None,
    moved: Mapping[str, RigidTransform] = _UNMOVED,
    moved_from: int = 0,
    sensors: Sensors = "real",
    keep_every: int = 1,
    with_log: bool = False,
) -> SimulatedDrive:
    """Simulate what a rig sees at the stops of a drive through a scene; the same arguments give the same bits.

    The vehicle, with the errors of its LiDARs, is the same at all stops. Traffic and people are others at each stop.

    Args:
        route: one of `ROUTES`.
        frames: per LiDAR and stop, at 10 Hz.
        step_m: length of the way from stop to stop; None: as usual on the route.
        disturbances: as for `simulate_snapshot`, but for ``moving``.
        parked: cars that stand beside the route at some of the stops only.
        moved, moved_from: LiDARs that are no longer as built from that stop on, counted from 0, each with its pose in
            its own frame as built.
        keep_every: thinning of the returns.
        with_log: also take the frames on the way, 3 s from stop to stop, each beam from where the vehicle is when it is
            fired; points of ideal LiDARs then tell their time, too.

    Raises:
        UnknownNameError: no such rig, scene, route, disturbance, or LiDAR of a disturbance or motion.
        UsageError: a negative number, no stop or frame, a disturbance that the drive cannot have, or a scene without
            room for it.
    """
    built = seed if build_seed is None else build_seed
    vehicle = draw_vehicle(rig, scene, seed, built, frames, disturbances, _UNMOVED, sensors)
    if "moving" in disturbances:
        raise UsageError("The vehicle stands at the stops of a drive; leave out the disturbance 'moving'.")
    if route not in PASSABLE_ROUTES and any(text.startswith("traffic:") for text in disturbances):
        raise UsageError(f"Traffic would drive into a vehicle that turns; choose the route {listed(PASSABLE_ROUTES)}.")
    if min(parked, moved_from) < 0 or keep_every < 1:
        raise UsageError(
            f"Found {parked} parked cars, a motion from stop {moved_from} on and every {keep_every}th return."
        )
    legs = plan_legs(route, stops, random_stream("route", route, rig, scene, seed), step_m)
    drive = _Drive(vehicle, scene, seed, legs, disturbances, frames, parked, with_log)
    poses_from = with_motions(vehicle.T_base_lidar, moved, rig)
    lidars = [
        drive.scans(mount, (vehicle.T_base_lidar[mount.name], poses_from[mount.name]), moved_from, keep_every)
        for mount in vehicle.rig.mounts
    ]
    number = "" if build_seed is None else f", vehicle {build_seed}"
    label = f"simulation {drive.world.label}{number}, {route}"
    label += f" with {', '.join(disturbances)}" if disturbances else ""
    at_stops = [[replace(each, scans=each.scans[start:end]) for each in lidars] for start, end in drive.slices]
    snapshots = tuple(
        Snapshot(tuple(each), f"{label}, stop {index + 1}", static_transforms=vehicle.static_transforms)
        for index, each in enumerate(at_stops)
    )
    log = Snapshot(tuple(lidars), label, static_transforms=vehicle.static_transforms) if with_log else None
    truths = [poses_from if index >= moved_from else vehicle.T_base_lidar for index in range(stops)]
    return SimulatedDrive(
        snapshots,
        tuple(Extrinsics(BASE, poses) for poses in truths),
        drive.poses,
        tuple(_span_ns(snapshot) for snapshot in snapshots),
        log,
    )


def _span_ns(snapshot: Snapshot) -> tuple[int, int]:
    stamps_ns = [scan.stamp_ns for lidar in snapshot.lidars for scan in lidar.scans]
    return min(stamps_ns), max(stamps_ns)


class _Drive:
    """The way of a vehicle by time; frames are numbered from the first stop on."""

    def __init__(
        self,
        vehicle: Vehicle,
        scene: str,
        seed: int,
        legs: list[Leg],
        disturbances: tuple[str, ...],
        frames: int,
        parked: int,
        with_log: bool,
    ) -> None:
        bare = SCENES[scene](random_stream(scene, seed))
        self._legs, self._places = legs, places_of(bare, legs)
        way = sweep(self._places, legs)
        self._scene = with_room_along(bare, vehicle.rig, way)
        place = (scene, seed)
        T_world_way = [pose_at(self._scene, each) for each in way]
        self.world = World(
            vehicle.rig, self._scene, place, vehicle.T_base_lidar, disturbances, is_timed=with_log, way=T_world_way
        )
        self._units, self._with_log = vehicle.units, with_log
        self._stand, self._cycle = frames, frames + 1 + _LEG_FRAMES
        at_stops = [standing_at(self._scene, each) for each in self._places]
        keys = [(), *((stop,) for stop in range(1, len(at_stops)))]
        lasting_s = self._cycle * FRAME_S
        self._movers = [
            self.world.movers(standing, *key, lasting_s=lasting_s) for standing, key in zip(at_stops, keys, strict=True)
        ]
        lanes_m = {car.lane_y_m for movers in self._movers for car in movers.cars}
        cars = _parked_cars(self.world, self._places, lanes_m, parked, random_stream("parked", *place))
        self._parked = [
            tuple(car for car, first, end in cars if first <= stop < end) for stop in range(len(self._places))
        ]

    @property
    def poses(self) -> tuple[RigidTransform, ...]:
        """``T_first_stop_base`` at each stop."""
        T_world_base = [pose_at(self._scene, place) for place in self._places]
        first = RigidTransform(FIRST_STOP, "world", T_world_base[0].inverse().matrix)
        return tuple(first @ pose for pose in T_world_base)

    @property
    def slices(self) -> list[tuple[int, int]]:
        """First and last frame of each stop, the last one exclusive, among the frames that are taken."""
        step = self._cycle if self._with_log else self._stand
        return [(step * index, step * index + self._stand) for index in range(len(self._places))]

    def scans(
        self, mount: Mount, T_base_lidar: tuple[RigidTransform, RigidTransform], moved_from: int, keep_every: int
    ) -> LidarScans:
        """Take the frames of a LiDAR, which has the second pose from a stop on."""
        unit, scans = self._units[mount.name], []
        delay_s = self.world.delays_s[mount.name]
        for frame in range(self._cycle * (len(self._places) - 1) + self._stand):
            stop, since = divmod(frame, self._cycle)
            if since >= self._stand and not self._with_log:
                continue
            # Halfway to the next stop, its cars are parked and its motions have happened.
            next_or_this = stop + (since > self._stand + 1 + _LEG_FRAMES // 2)
            time_s = frame * FRAME_S + delay_s
            moving = self._movers[stop].at(time_s - stop * self._cycle * FRAME_S)
            movers = merged([moving, *self._parked[next_or_this]])
            stamp_ns, pose = FIRST_STAMP_NS + round(time_s * 1e9), T_base_lidar[next_or_this >= moved_from]
            on_way = [self._pose(time_s + share * FRAME_S) for share in WAY_SHARES]
            scans.append(self.world.scan(mount, unit, Exposure(frame, stamp_ns, pose, on_way, movers)))
        return thinned_scans(LidarScans(mount.name, tuple(scans), topic=topic_of(mount.name)), keep_every)

    def _pose(self, time_s: float) -> RigidTransform:
        """Return ``T_world_base`` at a time; the vehicle sets out a frame after the last one of a stop."""
        stop, since_s = divmod(time_s, self._cycle * FRAME_S)
        share = (since_s / FRAME_S - self._stand - 1) / _LEG_FRAMES
        if share <= 0.0:
            return pose_at(self._scene, self._places[int(stop)])
        eased = share * share * (3.0 - 2.0 * share)
        return pose_at(self._scene, self._legs[int(stop)].end(self._places[int(stop)], eased))


def _parked_cars(
    world: World, places: list[Place], lanes_m: Collection[float], count: int, rng: np.random.Generator
) -> list[tuple[Mesh, int, int]]:
    """Draw cars in plain view of the stops, not on the way, with the first stop and the last one, exclusive, of each.

    Args:
        lanes_m: y of the cars that drive past, which the parked ones keep free.

    Raises:
        UsageError: there is no room for so many.
    """
    cars: list[tuple[Mesh, int, int]] = []
    failures = 0
    for _ in range(_CAR_TRIES * count):
        if len(cars) == count or failures == _CAR_FAILURES:
            break
        place = places[int(rng.integers(len(places)))]
        azimuth_rad, range_m = rng.uniform(-np.pi, np.pi), rng.uniform(_CAR_NEAR_M, _CAR_FAR_M)
        spot_m = (range_m * float(np.cos(azimuth_rad)), range_m * float(np.sin(azimuth_rad)), 0.0)
        turn_rad = float(rng.choice([0.0, np.pi / 2.0])) + rng.normal(scale=0.05)
        body, leaves, switch = random_car(rng), rng.random() < 0.5, int(rng.integers(1, max(2, len(places))))
        T_world_base = pose_at(world.scene, place)
        x_m, y_m, _ = T_world_base.apply(spot_m).tolist()
        at = (x_m, y_m, place[2] + turn_rad)
        failures += 1
        if not _is_visible(world, T_world_base, azimuth_rad, range_m) or _reaches_lane(at, lanes_m):
            continue
        if any(_reaches_car(world.rig.body.transformed(pose), world.scene, at) for pose in world.way):
            continue
        if any(_reaches_car(each, world.scene, at) for each in (world.obstacles, *(other for other, _, _ in cars))):
            continue
        failures = 0
        parked = world.scene.terrain.place(body, *at)
        cars.append((parked, 0, switch) if leaves else (parked, switch, len(places)))
    if len(cars) < count:
        raise UsageError(f"Found room for {len(cars)} parked cars beside the route, expected {count}; ask for fewer.")
    return cars


def _is_visible(world: World, T_world_base: RigidTransform, azimuth_rad: float, range_m: float) -> bool:
    eye = RigidTransform.from_xyz_rpy(BASE, "eye", (0.0, 0.0, _EYE_M), (0.0, 0.0, 0.0))
    beam = unit_directions(np.array([azimuth_rad]), np.zeros(1))
    return bool(world.sees(T_world_base @ eye, beam)[0] > range_m + 1.0)


def _reaches_lane(at: Place, lanes_m: Collection[float]) -> bool:
    """Return whether a car that stands there reaches into the way of one that drives along the x axis."""
    _, y_m, yaw_rad = at
    half_length_m, half_width_m, _ = _CAR_HIGH_M
    reach_m = half_width_m + abs(np.sin(yaw_rad)) * half_length_m + abs(np.cos(yaw_rad)) * half_width_m
    return any(abs(y_m - lane_m) < reach_m for lane_m in lanes_m)


def _reaches_car(body: Mesh, scene: Scene, at: Place) -> bool:
    """Return whether a body in the world frame reaches into a car that stands there."""
    return reaches_into(body.transformed(pose_at(scene, at).inverse()), _CAR_LOW_M, _CAR_HIGH_M)
