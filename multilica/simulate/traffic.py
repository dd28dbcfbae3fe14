# SPDX-License-Identifier: Apache-2.0
"""Road users around the vehicle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from multilica.geometry import RigidTransform
from multilica.simulate.patterns import unit_directions
from multilica.simulate.raycast import Surroundings, cast
from multilica.simulate.rigs import BASE, Mount
from multilica.simulate.scenes import Scene
from multilica.simulate.shapes.mesh import Mesh, merged
from multilica.simulate.shapes.vehicles import pedestrian, truck

__all__ = ["Walker", "pedestrians", "random_walkers", "truck_beside"]

_TRUCK_HEIGHT_M = 3.9
_TRUCK_GAPS_M = (0.5, 0.9, 1.5)
_STEP_M = 0.7
_EYE_M = 1.1
_NEAREST_WALKER_M = 3.5


@dataclass(frozen=True, slots=True)
class Walker:
    """A pedestrian who walks straight on.

    Args:
        xy_m: place in the world frame at the first frame.
        heading_rad, speed_m_s: of the walk.
    """

    xy_m: tuple[float, float]
    heading_rad: float
    speed_m_s: float
    height_m: float
    phase_rad: float


def random_walkers(scene: Scene, fixed: Surroundings, rng: np.random.Generator) -> tuple[Walker, ...]:
    """Up to ten people between 3.5 and 16 m from the vehicle, in plain view of it, who do not walk towards it."""
    azimuths_rad = rng.uniform(-np.pi, np.pi, size=30)
    origin = RigidTransform.from_xyz_rpy(BASE, "eye", (0.0, 0.0, _EYE_M), (0.0, 0.0, 0.0))
    T_world_eye = scene.T_world_base @ origin
    free_m = cast(fixed, T_world_eye, unit_directions(azimuths_rad, np.zeros(30))).ranges_m - 0.8
    visible = np.flatnonzero(free_m > _NEAREST_WALKER_M)[:10]
    spots_m = rng.uniform(_NEAREST_WALKER_M, np.minimum(free_m[visible], 16.0))
    return tuple(
        _random_walker(T_world_eye, float(azimuth_rad), float(spot_m), rng)
        for azimuth_rad, spot_m in zip(azimuths_rad[visible], spots_m, strict=True)
    )


def _random_walker(T_world_eye: RigidTransform, azimuth_rad: float, range_m: float, rng: np.random.Generator) -> Walker:
    spot_m = [range_m * float(np.cos(azimuth_rad)), range_m * float(np.sin(azimuth_rad)), 0.0]
    x_m, y_m, _ = T_world_eye.apply(spot_m).tolist()
    heading_rad = float(T_world_eye.rpy_rad[2]) + azimuth_rad + rng.uniform(-0.6, 0.6) * np.pi
    return Walker((x_m, y_m), heading_rad, rng.uniform(0.8, 1.7), rng.uniform(1.2, 1.9), rng.uniform(0.0, np.pi))


def pedestrians(scene: Scene, walkers: tuple[Walker, ...], time_s: float) -> Mesh:
    """The walkers in the world frame at a time after the first frame."""
    return merged([_walking(scene, walker, time_s) for walker in walkers])


def _walking(scene: Scene, walker: Walker, time_s: float) -> Mesh:
    way_m = walker.speed_m_s * time_s
    stride_rad = 0.45 * float(np.sin(np.pi * way_m / _STEP_M + walker.phase_rad))
    x_m = walker.xy_m[0] + way_m * float(np.cos(walker.heading_rad))
    y_m = walker.xy_m[1] + way_m * float(np.sin(walker.heading_rad))
    return scene.terrain.place(pedestrian(walker.height_m, stride_rad), x_m, y_m, walker.heading_rad)


def truck_beside(scene: Scene, mount: Mount, T_base_lidar: RigidTransform, rng: np.random.Generator) -> Mesh:
    """A truck in the world frame, where it blocks the share of the LiDAR's beams that is nearest to one half."""
    body = truck(rng.uniform(10.0, 14.0), min(_TRUCK_HEIGHT_M, scene.headroom_m))
    directions = mount.sensor.pattern.directions(0, rng)[::41]
    parked = [body.moved(x, y, 0.0, yaw) for x, y, yaw in _truck_spots(body)]
    shares = [
        float(np.isfinite(cast(Surroundings.of(BASE, mesh), T_base_lidar, directions).ranges_m).mean())
        for mesh in parked
    ]
    return parked[int(np.argmin(np.abs(np.array(shares) - 0.5)))].transformed(scene.T_world_base)


def _truck_spots(body: Mesh) -> list[tuple[float, float, float]]:
    """(x, y, yaw) in the base frame: alongside on either side, or across the road before or behind."""
    half_m = float(body.vertices_m[:, 0].max())
    alongside = [
        (x, side * (0.9 + gap + 1.25), 0.0)
        for side in (-1.0, 1.0)
        for gap in _TRUCK_GAPS_M
        for x in np.linspace(-half_m, half_m, 9).tolist()
    ]
    across = [
        (end * (2.3 + gap + 1.25), y, np.pi / 2.0)
        for end in (-1.0, 1.0)
        for gap in _TRUCK_GAPS_M
        for y in np.linspace(-half_m - 1.0, half_m + 1.0, 9).tolist()
    ]
    return alongside + across
