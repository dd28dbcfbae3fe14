# SPDX-License-Identifier: Apache-2.0
"""Disturbances of a snapshot, by name."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from multilica.errors import UnknownNameError, UsageError
from multilica.geometry import FloatArray, RigidTransform
from multilica.simulate.rigs import BASE, Mount, Rig
from multilica.simulate.scenes import Scene
from multilica.simulate.sensors import Hits, SensorModel, Surroundings, unit_directions
from multilica.simulate.shapes.mesh import Mesh, merged, reaches_into
from multilica.simulate.shapes.objects import pedestrian, truck
from multilica.simulate.traffic import FLOWS

DISTURBANCES: Mapping[str, str] = {
    "dead:<lidar>": "that LiDAR returns nothing",
    "dirty:<lidar>": "a connected half of that LiDAR's beams is blocked at its window",
    "ego_masked": "returns from the vehicle itself are left out, as most drivers do",
    "low_overlap": "rig chain only: neighbours share about one tenth of their field of view",
    "moving": "the vehicle moves at 3 m/s",
    "pedestrians": "people walk around the vehicle",
    "rain": "2 % of the returns are strays at random nearer ranges",
    "traffic:<flow>": "cars drive past: one_way, both_ways or queue; each LiDAR scans up to 60 ms after the first",
    "truck": "a truck beside the vehicle, off the way of a drive, blocks about half of one LiDAR's view",
}
_RAIN_SHARE = 0.02
_DIRT_ECHO_SHARE = 0.3
_DIRT_ECHO_M = (0.3, 0.95)
_TRUCK_HEIGHT_M = 3.9
_TRUCK_GAPS_M = (0.5, 0.9, 1.5)
_STEP_M = 0.7
_EYE_M = 1.1
_NEAREST_WALKER_M = 3.5


def require_known(disturbances: Collection[str], rig: str, lidars: Collection[str]) -> None:
    """Raise UnknownNameError or UsageError if a rig with these LiDARs cannot have these disturbances."""
    for text in disturbances:
        kind, _, argument = text.partition(":")
        if kind in ("dead", "dirty"):
            if argument not in lidars:
                raise UnknownNameError("LiDAR", argument, lidars, f"rig '{rig}' for disturbance '{text}'")
        elif kind == "traffic":
            if argument not in FLOWS:
                raise UnknownNameError("traffic", argument, FLOWS)
        elif text not in DISTURBANCES:
            raise UnknownNameError("disturbance", text, DISTURBANCES)
    if "low_overlap" in disturbances and rig != "chain":
        raise UsageError(f"Disturbance 'low_overlap' exists only for rig 'chain', not for rig '{rig}'; leave it out.")


def add_rain(sensor: SensorModel, ranges_m: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Replace some returns by drops at random nearer ranges."""
    struck = np.isfinite(ranges_m) & (rng.random(len(ranges_m)) < _RAIN_SHARE)
    drops_m = sensor.min_range_m + rng.random(len(ranges_m)) * (ranges_m - sensor.min_range_m)
    return np.where(struck, drops_m, ranges_m)


def add_dirt(directions: FloatArray, ranges_m: FloatArray, axis: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Block half of the beams: most of these return nothing, the others an echo below one metre."""
    echo = rng.random(len(ranges_m)) < _DIRT_ECHO_SHARE
    dirt_m = np.where(echo, rng.uniform(*_DIRT_ECHO_M, size=len(ranges_m)), np.nan)
    return np.where(blocked_beams(directions, axis), dirt_m, ranges_m)


def mask_ego(hits: Hits, of_vehicle: Hits) -> Hits:
    """Take the hits off the beams that meet the own vehicle first."""
    return replace(hits, ranges_m=np.where(of_vehicle.ranges_m <= hits.ranges_m, np.inf, hits.ranges_m))


def blocked_beams(directions: FloatArray, axis: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return a mask of the half of the beams (N, 3) closest to the axis (3,): one connected patch of the window."""
    lean = directions @ axis
    return np.asarray(lean > np.median(lean))


@dataclass(frozen=True, slots=True)
class Walker:
    """A pedestrian who walks straight on from a place in the world frame."""

    xy_m: tuple[float, float]
    heading_rad: float
    speed_m_s: float
    height_m: float
    phase_rad: float


def random_walkers(scene: Scene, rig: Rig, fixed: Surroundings, rng: np.random.Generator) -> tuple[Walker, ...]:
    """Place up to ten people 3.5 to 16 m away, in plain view of the vehicle and not walking towards it.

    From a long vehicle they keep a metre.
    """
    nearest_m = max(_NEAREST_WALKER_M, float(np.hypot(*rig.half_size_m)) + 1.0)
    azimuths_rad = rng.uniform(-np.pi, np.pi, size=30)
    origin = RigidTransform.from_xyz_rpy(BASE, "eye", (0.0, 0.0, _EYE_M), (0.0, 0.0, 0.0))
    T_world_eye = scene.T_world_base @ origin
    free_m = fixed.cast(T_world_eye, unit_directions(azimuths_rad, np.zeros(30))).ranges_m - 0.8
    visible = np.flatnonzero(free_m > nearest_m)[:10]
    ranges_m = rng.uniform(nearest_m, np.minimum(free_m[visible], 16.0))
    walkers = []
    for azimuth_rad, range_m in zip(azimuths_rad[visible].tolist(), ranges_m.tolist(), strict=True):
        spot_m = [range_m * float(np.cos(azimuth_rad)), range_m * float(np.sin(azimuth_rad)), 0.0]
        x_m, y_m, _ = T_world_eye.apply(spot_m).tolist()
        heading_rad = float(T_world_eye.rpy_rad[2]) + azimuth_rad + rng.uniform(-0.6, 0.6) * np.pi
        speed_m_s, height_m, phase_rad = rng.uniform(0.8, 1.7), rng.uniform(1.2, 1.9), rng.uniform(0.0, np.pi)
        walkers.append(Walker((x_m, y_m), heading_rad, speed_m_s, height_m, phase_rad))
    return tuple(walkers)


def pedestrians(scene: Scene, walkers: tuple[Walker, ...], time_s: float) -> Mesh:
    """Build the walkers in the world frame at a time after the first frame."""
    meshes = []
    for walker in walkers:
        way_m = walker.speed_m_s * time_s
        stride_rad = 0.45 * float(np.sin(np.pi * way_m / _STEP_M + walker.phase_rad))
        x_m = walker.xy_m[0] + way_m * float(np.cos(walker.heading_rad))
        y_m = walker.xy_m[1] + way_m * float(np.sin(walker.heading_rad))
        meshes.append(scene.terrain.place(pedestrian(walker.height_m, stride_rad), x_m, y_m, walker.heading_rad))
    return merged(meshes)


def truck_beside(
    scene: Scene,
    rig: Rig,
    mount: Mount,
    T_base_lidar: RigidTransform,
    rng: np.random.Generator,
    way: Sequence[RigidTransform] = (),
) -> Mesh:
    """Build a truck in the world frame, at the place where it blocks closest to half of the LiDAR's beams.

    Args:
        way: poses ``T_world_base`` of the vehicle on its drive, which the truck leaves free.

    Raises:
        UsageError: every place is on the way.
    """
    body = truck(rng.uniform(10.0, 14.0), min(_TRUCK_HEIGHT_M, scene.headroom_m))
    directions = mount.sensor.pattern.directions(0, rng)[::41]
    parked = list(_beside(rig, body))
    blocked = [np.isfinite(Surroundings(mesh).cast(T_base_lidar, directions).ranges_m).mean() for mesh in parked]
    for index in map(int, np.argsort(np.abs(np.array(blocked) - 0.5), kind="stable")):
        placed = parked[index].transformed(scene.T_world_base)
        if not any(reaches_into(placed.transformed(pose.inverse()), *rig.room_m) for pose in way):
            return placed
    raise UsageError(
        "The truck has no place beside the vehicle that the drive leaves free; choose another seed or route, or leave "
        "out the disturbance 'truck'."
    )


def _beside(rig: Rig, body: Mesh) -> Iterator[Mesh]:
    """Yield a truck at places along and across the vehicle, on each side, in the base frame."""
    half_length_m, half_width_m = rig.half_size_m
    half_m = float(body.vertices_m[:, 0].max())
    for across, away_m, reach_m in ((False, half_width_m, half_m), (True, half_length_m, half_m + 1.0)):
        for side in (-1.0, 1.0):
            for gap_m in _TRUCK_GAPS_M:
                for along_m in np.linspace(-reach_m, reach_m, 9).tolist():
                    beside_m = side * (away_m + gap_m + 1.25)
                    if across:
                        yield body.moved(beside_m, along_m, yaw_rad=np.pi / 2.0)
                    else:
                        yield body.moved(along_m, beside_m)
