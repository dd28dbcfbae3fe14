# SPDX-License-Identifier: Apache-2.0
"""Simulation of a snapshot of a rig in a scene."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np

from multilica.errors import UnknownNameError, UsageError
from multilica.extrinsics import Extrinsics
from multilica.geometry import RigidTransform
from multilica.simulate.disturbances import require_known
from multilica.simulate.rigs import BASE, RIGS, Rig, as_built, chain_rig, with_drawing_error
from multilica.simulate.scenes import SCENES, Scene
from multilica.simulate.units import LidarUnit, draw_unit
from multilica.simulate.world import FRAME_S, WAY_SHARES, Exposure, World, random_stream
from multilica.snapshot import LidarScans, Snapshot

FIRST_STAMP_NS = 1_767_225_600_000_000_000
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
    start_ns: int = FIRST_STAMP_NS,
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
    vehicle = draw_vehicle(rig, scene, seed, built, frames, disturbances, moved, sensors)
    chosen, poses = vehicle.rig, vehicle.T_base_lidar
    standing = SCENES[scene](random_stream(scene, seed)).with_room_for(*chosen.room_m)
    world = World(chosen, standing, (scene, seed), poses, disturbances)
    movers, delays_s = world.movers(standing), world.delays_s
    lidars = []
    for mount in chosen.mounts:
        scans = []
        for frame in range(frames):
            time_s = frame * FRAME_S + delays_s[mount.name]
            stamp_ns = start_ns + round(time_s * 1e9)
            on_way = [_pose(standing, disturbances, time_s + share * FRAME_S) for share in WAY_SHARES]
            taken = Exposure(frame, stamp_ns, poses[mount.name], on_way, movers.at(time_s))
            scans.append(world.scan(mount, vehicle.units[mount.name], taken))
        lidars.append(LidarScans(mount.name, tuple(scans), topic=topic_of(mount.name)))
    number = "" if build_seed is None else f", vehicle {build_seed}"
    description = f"simulation {world.label}{number}" + (f" with {', '.join(disturbances)}" if disturbances else "")
    snapshot = Snapshot(tuple(lidars), description, static_transforms=vehicle.static_transforms)
    return Simulation(snapshot, Extrinsics(BASE, poses))


@dataclass(frozen=True, slots=True, eq=False)
class Vehicle:
    """A vehicle as built, with the errors of its LiDARs.

    Args:
        units: by LiDAR; None: ideal.
        static_transforms: of the drawing, as its recordings hold them.
    """

    rig: Rig
    T_base_lidar: Mapping[str, RigidTransform]
    units: Mapping[str, LidarUnit | None]
    static_transforms: tuple[RigidTransform, ...]


def draw_vehicle(
    rig: str,
    scene: str,
    seed: int,
    build_seed: int,
    frames: int,
    disturbances: tuple[str, ...],
    moved: Mapping[str, RigidTransform],
    sensors: Sensors,
) -> Vehicle:
    """Check the arguments of a simulation, and draw the vehicle, its moved LiDARs where they are now.

    Raises:
        UnknownNameError: no such rig, scene, disturbance, or LiDAR of a disturbance or motion.
        UsageError: a negative seed, no frame, or a disturbance that the rig cannot have.
    """
    for kind, name, available in (("rig", rig, RIGS), ("scene", scene, SCENES)):
        if name not in available:
            raise UnknownNameError(kind, name, available)
    if min(seed, build_seed) < 0 or frames < 1:
        raise UsageError(
            f"A simulation needs seeds of at least 0 and at least one frame, found seed {min(seed, build_seed)} "
            f"and {frames} frames."
        )
    require_known(disturbances, rig, [mount.name for mount in RIGS[rig].mounts])
    chosen = chain_rig(_LOW_OVERLAP_DEG) if "low_overlap" in disturbances else RIGS[rig]
    original = as_built(chosen, random_stream(rig, "mounting", build_seed))
    units = {
        mount.name: draw_unit(mount.sensor, random_stream(rig, mount.name, "unit", build_seed))
        if sensors == "real"
        else None
        for mount in chosen.mounts
    }
    priors = random_stream(rig, "prior", build_seed)
    static = tuple(with_drawing_error(pose, priors) for pose in original.values())
    return Vehicle(chosen, with_motions(original, moved, rig), units, static)


def topic_of(lidar: str) -> str:
    """Return the topic of a simulated LiDAR."""
    return f"/lidar/{lidar}/points"


def _pose(scene: Scene, disturbances: Collection[str], time_s: float) -> RigidTransform:
    """Return ``T_world_base`` at a time after the first frame."""
    way_m = _SPEED_M_S * time_s if "moving" in disturbances else 0.0
    x_m = scene.vehicle_xy_m[0] + way_m * float(np.cos(scene.vehicle_yaw_rad))
    y_m = scene.vehicle_xy_m[1] + way_m * float(np.sin(scene.vehicle_yaw_rad))
    return scene.terrain.standing_pose(x_m, y_m, scene.vehicle_yaw_rad)


def true_extrinsics(rig: str, build_seed: int, moved: Mapping[str, RigidTransform] = _UNMOVED) -> Extrinsics:
    """Return the truth of `simulate_snapshot` for a vehicle, without a simulation.

    Raises:
        UnknownNameError: no such rig, or no such LiDAR of a motion.
    """
    if rig not in RIGS:
        raise UnknownNameError("rig", rig, RIGS)
    return Extrinsics(BASE, with_motions(as_built(RIGS[rig], random_stream(rig, "mounting", build_seed)), moved, rig))


def with_motions(
    poses: Mapping[str, RigidTransform], moved: Mapping[str, RigidTransform], rig: str
) -> dict[str, RigidTransform]:
    """Return the poses of LiDARs as built, some of them moved; raise UnknownNameError if there is no such LiDAR."""
    for name in moved:
        if name not in poses:
            raise UnknownNameError("LiDAR", name, poses, f"rig '{rig}'")
    return {name: pose @ moved[name] if name in moved else pose for name, pose in poses.items()}


def thinned(snapshot: Snapshot, keep_every: int) -> Snapshot:
    """Keep only every Nth return; the first one differs from frame to frame, so that together they cover all beams."""
    return replace(snapshot, lidars=tuple(thinned_scans(lidar, keep_every) for lidar in snapshot.lidars))


def thinned_scans(lidar: LidarScans, keep_every: int) -> LidarScans:
    """Do the same to one LiDAR."""
    kept = [slice(index % keep_every, None, keep_every) for index in range(len(lidar.scans))]
    return replace(lidar, scans=tuple(scan.selected(each) for scan, each in zip(lidar.scans, kept, strict=True)))
