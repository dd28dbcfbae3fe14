# SPDX-License-Identifier: Apache-2.0
"""A snapshot that a rig would take in a scene, with its truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from multilica.errors import UnknownNameError, UsageError
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.simulate.corruption import soiled, with_rain
from multilica.simulate.disturbances import Disturbances, parse_disturbances
from multilica.simulate.raycast import Surroundings, cast, measure, nearer, returned_points
from multilica.simulate.rigs import BASE, RIGS, Mount, Rig, as_built, fan, misjudged, vehicle_body
from multilica.simulate.scenes import SCENES, Scene
from multilica.simulate.shapes.mesh import merged
from multilica.simulate.traffic import Walker, pedestrians, random_walkers, truck_beside
from multilica.snapshot import LidarScans, Scan, Snapshot

__all__ = ["Simulation", "simulate_snapshot"]

_FIRST_STAMP_NS = 1_767_225_600_000_000_000
_FRAME_S = 0.1
_SPEED_M_S = 3.0
_LOW_OVERLAP_DEG = 9.0


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A simulated snapshot.

    Args:
        snapshot: what the rig saw; its static transforms claim poses that are off by about 5 cm and 2 degrees.
        truth: ``T_base_<lidar>``, exact; base is ISO 8855, on the ground below the vehicle's middle.
        description: the request in one line.
    """

    snapshot: Snapshot
    truth: Extrinsics
    description: str


@dataclass(frozen=True, slots=True, eq=False)
class _World:
    """Everything that beams can meet."""

    scene: Scene
    fixed: Surroundings
    vehicle: Surroundings
    walkers: tuple[Walker, ...]
    speed_m_s: float

    def pose(self, time_s: float) -> RigidTransform:
        """``T_world_base`` at a time after the first frame."""
        yaw_rad, way_m = self.scene.vehicle_yaw_rad, self.speed_m_s * time_s
        x_m = self.scene.vehicle_xy_m[0] + way_m * float(np.cos(yaw_rad))
        y_m = self.scene.vehicle_xy_m[1] + way_m * float(np.sin(yaw_rad))
        return self.scene.terrain.standing_pose(x_m, y_m, yaw_rad)


def simulate_snapshot(
    rig: str,
    scene: str,
    seed: int,
    *,
    frames: int = 5,
    disturbances: tuple[str, ...] = (),
    build_seed: int | None = None,
) -> Simulation:
    """Cast the beams of a rig into a scene; the same arguments give the same bits.

    The surroundings depend on scene and seed only, the mounting on rig and build seed only.

    Args:
        rig: one of `RIGS`.
        scene: one of `SCENES`.
        seed: any whole number from 0.
        frames: per LiDAR, at 10 Hz.
        disturbances: any of `DISTURBANCES`, for instance ``("rain", "dead:left")``.
        build_seed: which vehicle it is; None: one of its own for each seed. The same vehicle has the same truth and the
            same static transforms wherever it stands.

    Raises:
        UnknownNameError: no such rig, scene, disturbance, or LiDAR of a disturbance.
        UsageError: a negative seed, no frame, or a disturbance that the rig cannot have.
    """
    built = seed if build_seed is None else build_seed
    _check(rig, scene, min(seed, built), frames)
    lidars = [mount.name for mount in RIGS[rig].mounts]
    asked = parse_disturbances(disturbances, rig, lidars)
    chosen = fan(_LOW_OVERLAP_DEG) if "low_overlap" in asked.general else RIGS[rig]
    label = f"{rig}/{scene}/seed {seed}"
    poses = as_built(chosen, _stream(rig, "mounting", built))
    world = _build_world(chosen, scene, seed, poses, asked)
    scans = tuple(_lidar_scans(world, mount, poses[mount.name], frames, asked, label) for mount in chosen.mounts)
    priors = _stream(rig, "prior", built)
    static = tuple(misjudged(pose, priors) for pose in poses.values())
    vehicle = "" if build_seed is None else f", vehicle {build_seed}"
    description = f"simulation {label}{vehicle}" + (f" with {', '.join(disturbances)}" if disturbances else "")
    return Simulation(Snapshot(scans, description, static_transforms=static), Extrinsics(BASE, poses), description)


def _check(rig: str, scene: str, seed: int, frames: int) -> None:
    for kind, name, available in (("rig", rig, RIGS), ("scene", scene, SCENES)):
        if name not in available:
            raise UnknownNameError(kind, name, available)
    if seed < 0 or frames < 1:
        raise UsageError(
            f"A simulation needs a seed of at least 0 and at least one frame, found seed {seed} and {frames} frames."
        )


def _stream(*keys: object) -> np.random.Generator:
    """Random numbers of their own for each purpose, so that one more draw in one place moves nothing elsewhere."""
    return np.random.default_rng(list("/".join(map(str, keys)).encode()))


def _build_world(
    rig: Rig, scene_name: str, seed: int, poses: Mapping[str, RigidTransform], asked: Disturbances
) -> _World:
    scene = SCENES[scene_name](_stream(scene_name, seed))
    meshes = [scene.mesh]
    if "truck" in asked.general:
        lorries = _stream("truck", rig.name, scene_name, seed)
        mount = rig.mounts[int(lorries.integers(len(rig.mounts)))]
        meshes.append(truck_beside(scene, mount, poses[mount.name], lorries))
    fixed = Surroundings.of("world", merged(meshes))
    walkers: tuple[Walker, ...] = ()
    if "pedestrians" in asked.general:
        walkers = random_walkers(scene, fixed, _stream("pedestrians", scene_name, seed))
    speed_m_s = _SPEED_M_S if "moving" in asked.general else 0.0
    return _World(scene, fixed, Surroundings.of(BASE, vehicle_body(rig)), walkers, speed_m_s)


def _lidar_scans(
    world: _World, mount: Mount, T_base_lidar: RigidTransform, frames: int, asked: Disturbances, label: str
) -> LidarScans:
    dirt_axis = _stream(label, mount.name, "dirt").normal(size=3)
    scans = []
    for frame in range(frames):
        rng = _stream(label, mount.name, frame)
        directions = mount.sensor.pattern.directions(frame, rng)
        ranges = _ranges(world, mount, T_base_lidar, directions, frame, rng)
        weather = _stream(label, mount.name, frame, "weather")
        if "rain" in asked.general:
            ranges = with_rain(mount.sensor, ranges, weather)
        if mount.name in asked.dirty:
            ranges = soiled(directions, ranges, dirt_axis, weather)
        if mount.name in asked.dead:
            ranges = np.full_like(ranges, np.nan)
        stamp_ns = _FIRST_STAMP_NS + round(frame * _FRAME_S * 1e9)
        scans.append(Scan(returned_points(directions, ranges), stamp_ns))
    return LidarScans(mount.name, tuple(scans), topic=f"/lidar/{mount.name}/points")


def _ranges(
    world: _World,
    mount: Mount,
    T_base_lidar: RigidTransform,
    directions: FloatArray,
    frame: int,
    rng: np.random.Generator,
) -> FloatArray:
    time_s = frame * _FRAME_S
    T_world_lidar = world.pose(time_s) @ T_base_lidar
    hits = nearer(cast(world.fixed, T_world_lidar, directions), cast(world.vehicle, T_base_lidar, directions))
    if world.walkers:
        people = Surroundings.of("world", pedestrians(world.scene, world.walkers, time_s))
        hits = nearer(hits, cast(people, T_world_lidar, directions))
    return measure(mount.sensor, hits, rng)
