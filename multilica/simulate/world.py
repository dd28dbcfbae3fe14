# SPDX-License-Identifier: Apache-2.0
"""Surfaces that the beams of a rig can hit, and the frames that its LiDARs take of them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from multilica.geometry import FloatArray, RigidTransform
from multilica.simulate.disturbances import (
    Walker,
    add_dirt,
    add_rain,
    mask_ego,
    pedestrians,
    random_walkers,
    truck_beside,
)
from multilica.simulate.rigs import Mount, Rig
from multilica.simulate.scenes import Scene
from multilica.simulate.sensors import Hits, Surroundings, measure, nearer, returned_points
from multilica.simulate.shapes.mesh import Mesh, merged
from multilica.simulate.traffic import FLOWS, LONGEST_DELAY_S, MovingCar, random_traffic, traffic
from multilica.simulate.units import LidarUnit, draw_reflectivities
from multilica.snapshot import Scan

FRAME_S = 0.1
WAY_SHARES = np.linspace(0.0, 1.0, 5)
"""Parts of a frame at which the pose of a moving vehicle is told."""


def random_stream(*keys: object) -> np.random.Generator:
    """Return random numbers for one purpose: another draw for one purpose does not change the others."""
    return np.random.default_rng(list("/".join(map(str, keys)).encode()))


@dataclass(frozen=True, slots=True, eq=False)
class Movers:
    """People and cars on their way."""

    scene: Scene
    walkers: tuple[Walker, ...]
    cars: tuple[MovingCar, ...]

    def at(self, time_s: float) -> Mesh:
        """Build them in the world frame at a time after the first frame."""
        return merged([pedestrians(self.scene, self.walkers, time_s), traffic(self.scene, self.cars, time_s)])


@dataclass(frozen=True, slots=True, eq=False)
class Exposure:
    """When and where a LiDAR takes a frame.

    Args:
        frame: number of the frame, which chooses its noise.
        T_world_base: pose of the vehicle, or its poses at even times from the start of the frame to its end.
        movers: bodies that are not part of the scene, in the world frame.
    """

    frame: int
    stamp_ns: int
    T_base_lidar: RigidTransform
    T_world_base: Sequence[RigidTransform]
    movers: Mesh


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """A scene around a rig.

    Args:
        scene: with room for the rig.
        place: name and seed of the scene.
        is_timed: ideal LiDARs report the time of each point, too; real ones always do.
        way: poses ``T_world_base`` on a drive, which a truck beside the vehicle leaves free.
        obstacles: all that stands there, in the world frame.
    """

    rig: Rig
    scene: Scene
    place: tuple[str, int]
    T_base_lidar: Mapping[str, RigidTransform]
    disturbances: tuple[str, ...] = ()
    is_timed: bool = False
    way: Sequence[RigidTransform] = ()
    obstacles: Mesh = field(init=False)
    _fixed: Surroundings = field(init=False)
    _vehicle: Surroundings = field(init=False)

    def __post_init__(self) -> None:
        name, seed = self.place
        meshes = [*self.scene.parts]
        if "truck" in self.disturbances:
            lorries = random_stream("truck", self.rig.name, name, seed)
            mount = self.rig.mounts[int(lorries.integers(len(self.rig.mounts)))]
            T_base_lidar = self.T_base_lidar[mount.name]
            meshes.append(truck_beside(self.scene, self.rig, mount, T_base_lidar, lorries, self.way))
        lengths_m = np.array([mesh.length_m for mesh in meshes])
        drawn = draw_reflectivities(lengths_m, random_stream(name, seed, "reflectivity"))
        object.__setattr__(self, "obstacles", merged(meshes))
        fixed = Surroundings(self.obstacles, np.repeat(drawn, [len(mesh.triangles) for mesh in meshes]))
        object.__setattr__(self, "_fixed", fixed)
        object.__setattr__(self, "_vehicle", Surroundings(self.rig.body))

    @property
    def label(self) -> str:
        """Rig, scene and seed, for descriptions."""
        return f"{self.rig.name}/{self.place[0]}/seed {self.place[1]}"

    @property
    def flows(self) -> tuple[str, ...]:
        """Kinds of traffic."""
        return tuple(text.removeprefix("traffic:") for text in self.disturbances if text.startswith("traffic:"))

    @property
    def delays_s(self) -> Mapping[str, float]:
        """By which each LiDAR starts its scans after the first."""
        starts = random_stream("delay", self.rig.name, *self.place)
        return {m.name: starts.uniform(0.0, LONGEST_DELAY_S) if self.flows else 0.0 for m in self.rig.mounts}

    def movers(self, scene: Scene, *keys: object, lasting_s: float = 0.0) -> Movers:
        """Draw walkers and traffic about the vehicle where it stands in the scene; further keys draw others."""
        drawn = random_stream("pedestrians", *self.place, *keys)
        has_walkers = "pedestrians" in self.disturbances
        walkers = random_walkers(scene, self.rig, self._fixed, drawn) if has_walkers else ()
        drivers = random_stream("traffic", *self.place, *keys)
        cars = [car for name in self.flows for car in random_traffic(scene, FLOWS[name], drivers, lasting_s)]
        return Movers(scene, walkers, tuple(cars))

    def sees(self, T_world_eye: RigidTransform, directions: FloatArray) -> FloatArray:
        """Return the distances (N,) of what stands in directions (N, 3) of an eye, inf where nothing does."""
        return self._fixed.cast(T_world_eye, directions).ranges_m

    def scan(self, mount: Mount, unit: LidarUnit | None, taken: Exposure) -> Scan:
        """Take a frame; without a unit, of an ideal LiDAR."""
        keys = (self.label, mount.name, taken.frame)
        rng = random_stream(*keys)
        directions = mount.sensor.pattern.directions(taken.frame, rng)
        cast = self._caster(taken)
        if unit is None:
            ranges, intensity = measure(mount.sensor, cast(directions), rng), None
        else:
            ranges, intensity = unit.measure(directions, cast, rng, random_stream(*keys, "optics"))
        weather = random_stream(*keys, "weather")
        if "rain" in self.disturbances:
            ranges = add_rain(mount.sensor, ranges, weather)
        if f"dirty:{mount.name}" in self.disturbances:
            axis = random_stream(self.label, mount.name, "dirt").normal(size=3)
            ranges = add_dirt(directions, ranges, axis, weather)
        if f"dead:{mount.name}" in self.disturbances:
            ranges = np.full_like(ranges, np.nan)
        scan = Scan(returned_points(directions, ranges), taken.stamp_ns)
        if intensity is not None:
            return _as_driver_sends(scan, mount, ranges, intensity)
        return replace(scan, times_ns=_times_ns(ranges)) if self.is_timed else scan

    def _caster(self, taken: Exposure) -> Callable[[FloatArray], Hits]:
        """Return what casts the beams of a frame, in the order in which they are fired."""
        movers = Surroundings(taken.movers) if len(taken.movers.triangles) else None
        is_still = all(np.array_equal(pose.matrix, taken.T_world_base[0].matrix) for pose in taken.T_world_base)
        T_world_lidar = taken.T_world_base[0] @ taken.T_base_lidar

        def cast(directions: FloatArray) -> Hits:
            of_vehicle = self._vehicle.cast(taken.T_base_lidar, directions)
            origins, turned = T_world_lidar.xyz_m, T_world_lidar.rotate(directions)
            if not is_still:
                origins, turned = _rolling(taken, directions)
            hits = nearer(self._fixed.cast_rays(origins, turned), of_vehicle)
            if movers is not None:
                hits = nearer(hits, movers.cast_rays(origins, turned))
            return mask_ego(hits, of_vehicle) if "ego_masked" in self.disturbances else hits

        return cast


def _rolling(taken: Exposure, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return origins (N, 3) and directions (N, 3) in the world of beams fired one after the other on the way."""
    poses = taken.T_world_base
    knots, shares = np.linspace(0.0, 1.0, len(poses)), np.arange(len(directions)) / len(directions)
    turns = Slerp(knots, Rotation.from_matrix([pose.rotation for pose in poses]))(shares)
    places_m = np.array([pose.xyz_m for pose in poses])
    base_m = np.stack([np.interp(shares, knots, axis) for axis in places_m.T], axis=1)
    lidar = taken.T_base_lidar
    return base_m + turns.apply(np.array(lidar.xyz_m)), turns.apply(lidar.rotate(directions))


def _as_driver_sends(scan: Scan, mount: Mount, ranges_m: FloatArray, intensity: FloatArray) -> Scan:
    """Add intensity, ring and time of each return."""
    returned = np.flatnonzero(np.isfinite(ranges_m))
    rings = mount.sensor.pattern.rings[returned].astype(np.uint16)
    return replace(scan, intensity=intensity[returned].astype(np.float32), rings=rings, times_ns=_times_ns(ranges_m))


def _times_ns(ranges_m: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.uint32]]:
    """Return the time of each return after the stamp; beams are fired one after the other."""
    returned = np.flatnonzero(np.isfinite(ranges_m))
    return (returned * round(FRAME_S * 1e9) // len(ranges_m)).astype(np.uint32)
