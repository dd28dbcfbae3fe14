# SPDX-License-Identifier: Apache-2.0
"""Simulation of a snapshot of a rig in a scene."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from multilica.errors import UnknownNameError, UsageError
from multilica.extrinsics import Extrinsics
from multilica.geometry import FloatArray, RigidTransform
from multilica.simulate.disturbances import (
    add_dirt,
    add_rain,
    mask_ego,
    pedestrians,
    random_walkers,
    require_known,
    truck_beside,
)
from multilica.simulate.rigs import BASE, RIGS, Mount, Rig, as_built, chain_rig, with_drawing_error
from multilica.simulate.scenes import SCENES
from multilica.simulate.sensors import Hits, Surroundings, measure, nearer, returned_points
from multilica.simulate.shapes.mesh import merged
from multilica.simulate.traffic import FLOWS, LONGEST_DELAY_S, random_traffic, traffic
from multilica.simulate.units import LidarUnit, draw_reflectivities, draw_unit
from multilica.snapshot import LidarScans, Scan, Snapshot

_FIRST_STAMP_NS = 1_767_225_600_000_000_000
_FRAME_S = 0.1
_SPEED_M_S = 3.0
_LOW_OVERLAP_DEG = 9.0
Sensors = Literal["real", "ideal"]
_UNMOVED: Mapping[str, RigidTransform] = MappingProxyType({})


@dataclass(frozen=True, slots=True, eq=False)
class Simulation:
    """A snapshot, with static transforms off by about 5 cm and 2 degrees, and the exact ``T_base_<lidar>``.

    The base frame is that of ISO 8855, on the ground below the vehicle's middle.
    """

    snapshot: Snapshot
    truth: Extrinsics


def simulate_snapshot(
    rig: str,
    scene: str,
    seed: int,
    *,
    frames: int = 5,
    disturbances: tuple[str, ...] = (),
    build_seed: int | None = None,
    moved: Mapping[str, RigidTransform] = _UNMOVED,
    start_ns: int = _FIRST_STAMP_NS,
    sensors: Sensors = "real",
) -> Simulation:
    """Simulate what a rig sees in a scene; the same arguments give the same bits.

    The surroundings depend on scene and seed only, but for what would stand in a large vehicle's place; the mounting
    and the LiDARs' own errors depend on rig and build seed only.

    Args:
        frames: per LiDAR, at 10 Hz; with traffic, each LiDAR starts its scans at another time, which its stamps tell.
        disturbances: any of `DISTURBANCES`, for instance ``("rain", "dead:left")``.
        build_seed: chooses the vehicle; None: `seed`. A vehicle has the same truth and the same static transforms
            in every scene.
        moved: LiDARs that are no longer as built, each with its pose in its own frame as built. The truth is where
            they are; the static transforms stay those of the vehicle as built.
        start_ns: stamp of the first frames.
        sensors: "real": as real LiDARs measure, with intensity, ring and time per point. "ideal": the ranges have
            white noise only, and points nothing but coordinates.

    Raises:
        UnknownNameError: no such rig, scene, disturbance, or LiDAR of a disturbance or motion.
        UsageError: a negative seed, no frame, a disturbance that the rig cannot have, or a scene without room for it.
    """
    built = seed if build_seed is None else build_seed
    for kind, name, available in (("rig", rig, RIGS), ("scene", scene, SCENES)):
        if name not in available:
            raise UnknownNameError(kind, name, available)
    if min(seed, built) < 0 or frames < 1:
        raise UsageError(
            f"A simulation needs seeds of at least 0 and at least one frame, found seed {min(seed, built)} "
            f"and {frames} frames."
        )
    require_known(disturbances, rig, [mount.name for mount in RIGS[rig].mounts])
    chosen = chain_rig(_LOW_OVERLAP_DEG) if "low_overlap" in disturbances else RIGS[rig]
    original = as_built(chosen, random_stream(rig, "mounting", built))
    poses = _moved(original, moved, rig)
    world = _World(chosen, scene, seed, poses, disturbances, start_ns)
    units = {
        mount.name: draw_unit(mount.sensor, random_stream(rig, mount.name, "unit", built))
        if sensors == "real"
        else None
        for mount in chosen.mounts
    }
    scans = tuple(world.scans(mount, units[mount.name], frames) for mount in chosen.mounts)
    priors = random_stream(rig, "prior", built)
    static = tuple(with_drawing_error(pose, priors) for pose in original.values())
    vehicle = "" if build_seed is None else f", vehicle {build_seed}"
    description = f"simulation {world.label}{vehicle}" + (f" with {', '.join(disturbances)}" if disturbances else "")
    return Simulation(Snapshot(tuple(scans), description, static_transforms=static), Extrinsics(BASE, poses))


def true_extrinsics(rig: str, build_seed: int, moved: Mapping[str, RigidTransform] = _UNMOVED) -> Extrinsics:
    """Return the truth of `simulate_snapshot` for a vehicle, without a simulation.

    Raises:
        UnknownNameError: no such rig, or no such LiDAR of a motion.
    """
    if rig not in RIGS:
        raise UnknownNameError("rig", rig, RIGS)
    return Extrinsics(BASE, _moved(as_built(RIGS[rig], random_stream(rig, "mounting", build_seed)), moved, rig))


def _moved(
    poses: dict[str, RigidTransform], moved: Mapping[str, RigidTransform], rig: str
) -> dict[str, RigidTransform]:
    for name in moved:
        if name not in poses:
            raise UnknownNameError("LiDAR", name, poses, f"rig '{rig}'")
    return {name: pose @ moved[name] if name in moved else pose for name, pose in poses.items()}


class _World:
    """Surfaces that beams can hit, fixed and moving."""

    def __init__(
        self,
        rig: Rig,
        scene: str,
        seed: int,
        poses: dict[str, RigidTransform],
        disturbances: tuple[str, ...],
        start_ns: int,
    ) -> None:
        self.label = f"{rig.name}/{scene}/seed {seed}"
        self._poses, self._disturbances, self._start_ns = poses, disturbances, start_ns
        self._scene = SCENES[scene](random_stream(scene, seed)).with_room_for(*rig.room_m)
        meshes = [*self._scene.parts]
        if "truck" in disturbances:
            lorries = random_stream("truck", rig.name, scene, seed)
            mount = rig.mounts[int(lorries.integers(len(rig.mounts)))]
            meshes.append(truck_beside(self._scene, rig, mount, poses[mount.name], lorries))
        lengths_m = np.array([mesh.length_m for mesh in meshes])
        drawn = draw_reflectivities(lengths_m, random_stream(scene, seed, "reflectivity"))
        self._fixed = Surroundings(merged(meshes), np.repeat(drawn, [len(mesh.triangles) for mesh in meshes]))
        self._vehicle = Surroundings(rig.body)
        walkers = random_stream("pedestrians", scene, seed)
        self._walkers = random_walkers(self._scene, rig, self._fixed, walkers) if "pedestrians" in disturbances else ()
        flows = [text.removeprefix("traffic:") for text in disturbances if text.startswith("traffic:")]
        drivers = random_stream("traffic", scene, seed)
        self._cars = [car for name in flows for car in random_traffic(self._scene, FLOWS[name], drivers)]
        starts = random_stream("delay", rig.name, scene, seed)
        self._delays_s = {mount.name: starts.uniform(0.0, LONGEST_DELAY_S) if flows else 0.0 for mount in rig.mounts}

    def scans(self, mount: Mount, unit: LidarUnit | None, frames: int) -> LidarScans:
        """Take the scans of one LiDAR; without a unit, of an ideal one."""
        dirt_axis = random_stream(self.label, mount.name, "dirt").normal(size=3)
        scans = []
        for frame in range(frames):
            rng = random_stream(self.label, mount.name, frame)
            directions = mount.sensor.pattern.directions(frame, rng)
            time_s = frame * _FRAME_S + self._delays_s[mount.name]
            cast = self._caster(mount, time_s)
            if unit is None:
                ranges, intensity = measure(mount.sensor, cast(directions), rng), None
            else:
                optics = random_stream(self.label, mount.name, frame, "optics")
                ranges, intensity = unit.measure(directions, cast, rng, optics)
            weather = random_stream(self.label, mount.name, frame, "weather")
            if "rain" in self._disturbances:
                ranges = add_rain(mount.sensor, ranges, weather)
            if f"dirty:{mount.name}" in self._disturbances:
                ranges = add_dirt(directions, ranges, dirt_axis, weather)
            if f"dead:{mount.name}" in self._disturbances:
                ranges = np.full_like(ranges, np.nan)
            stamp_ns = self._start_ns + round(time_s * 1e9)
            scan = Scan(returned_points(directions, ranges), stamp_ns)
            scans.append(scan if intensity is None else _as_driver_sends(scan, mount, ranges, intensity))
        return LidarScans(mount.name, tuple(scans), topic=f"/lidar/{mount.name}/points")

    def _caster(self, mount: Mount, time_s: float) -> Callable[[FloatArray], Hits]:
        """Return what casts the beams of a LiDAR at a time after the first frame."""
        T_base_lidar = self._poses[mount.name]
        T_world_lidar = self._pose(time_s) @ T_base_lidar
        moving = merged([pedestrians(self._scene, self._walkers, time_s), traffic(self._scene, self._cars, time_s)])
        movers = Surroundings(moving) if len(moving.triangles) else None

        def cast(directions: FloatArray) -> Hits:
            of_vehicle = self._vehicle.cast(T_base_lidar, directions)
            hits = nearer(self._fixed.cast(T_world_lidar, directions), of_vehicle)
            if movers is not None:
                hits = nearer(hits, movers.cast(T_world_lidar, directions))
            return mask_ego(hits, of_vehicle) if "ego_masked" in self._disturbances else hits

        return cast

    def _pose(self, time_s: float) -> RigidTransform:
        """Return ``T_world_base`` at a time after the first frame."""
        scene, way_m = self._scene, _SPEED_M_S * time_s if "moving" in self._disturbances else 0.0
        x_m = scene.vehicle_xy_m[0] + way_m * float(np.cos(scene.vehicle_yaw_rad))
        y_m = scene.vehicle_xy_m[1] + way_m * float(np.sin(scene.vehicle_yaw_rad))
        return scene.terrain.standing_pose(x_m, y_m, scene.vehicle_yaw_rad)


def _as_driver_sends(scan: Scan, mount: Mount, ranges_m: FloatArray, intensity: FloatArray) -> Scan:
    """Add intensity, ring and time of each return; beams are fired one after the other."""
    returned = np.flatnonzero(np.isfinite(ranges_m))
    times_ns = returned * round(_FRAME_S * 1e9) // len(ranges_m)
    rings = mount.sensor.pattern.rings[returned].astype(np.uint16)
    return replace(
        scan, intensity=intensity[returned].astype(np.float32), rings=rings, times_ns=times_ns.astype(np.uint32)
    )


def random_stream(*keys: object) -> np.random.Generator:
    """Return random numbers for one purpose: another draw for one purpose does not change the others."""
    return np.random.default_rng(list("/".join(map(str, keys)).encode()))


def thinned(snapshot: Snapshot, keep_every: int) -> Snapshot:
    """Keep only every Nth return; the first one differs from frame to frame, so that together they cover all beams."""
    lidars = []
    for lidar in snapshot.lidars:
        kept = [slice(index % keep_every, None, keep_every) for index in range(len(lidar.scans))]
        scans = tuple(scan.selected(each) for scan, each in zip(lidar.scans, kept, strict=True))
        lidars.append(replace(lidar, scans=scans))
    return replace(snapshot, lidars=tuple(lidars))
