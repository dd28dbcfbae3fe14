# SPDX-License-Identifier: Apache-2.0
"""Simulated vehicles with their LiDARs, by name: as drawn and as built."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.simulate.models import (
    AERIES_II,
    AVIA,
    FALCON,
    LONG_25,
    NARROW,
    OS1_64,
    OS1_128,
    OS2_128,
    ROOF_64,
    SIDE_32,
    SOLID_70,
    VLP_16,
)
from multilica.simulate.sensors import SensorModel
from multilica.simulate.shapes.mesh import Mesh, box, merged, tapered_box
from multilica.simulate.shapes.objects import wheels

BASE = "base"
_BUILD_SIGMA_M, _BUILD_SIGMA_RAD = 0.02, float(np.deg2rad(1.0))
_DRAWING_SIGMA_M, _DRAWING_SIGMA_RAD = 0.05, float(np.deg2rad(2.0))

# Past the vehicle's sides; uneven ground rises less than the other between its wheels.
_CLEARANCE_M = np.array([0.3, 0.3, 0.15])
_GROUND_CLEARANCE_M = 0.6


@dataclass(frozen=True, slots=True)
class Mount:
    """A LiDAR on the vehicle, with position and extrinsic xyz attitude in the base frame."""

    name: str
    sensor: SensorModel
    xyz_m: tuple[float, float, float]
    rpy_deg: tuple[float, float, float]

    @property
    def T_base_lidar(self) -> RigidTransform:  # noqa: N802 - the field's notation
        """Return the pose of the drawing."""
        rpy_rad = np.deg2rad(self.rpy_deg).tolist()
        return RigidTransform.from_xyz_rpy(BASE, self.name, self.xyz_m, rpy_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """A vehicle with its LiDARs; its body in the base frame."""

    name: str
    mounts: tuple[Mount, ...]
    body: Mesh

    @property
    def half_size_m(self) -> tuple[float, float]:
        """Return half of the body's length and of its width."""
        half_x_m, half_y_m, _ = np.abs(self.body.vertices_m).max(axis=0).tolist()
        return half_x_m, half_y_m

    @property
    def room_m(self) -> tuple[FloatArray, FloatArray]:
        """Return the corners (3,) of the box that must be free of other bodies, in the base frame."""
        outline = np.concatenate([self.body.vertices_m, [mount.xyz_m for mount in self.mounts]])
        low_m, high_m = outline.min(axis=0) - _CLEARANCE_M, outline.max(axis=0) + _CLEARANCE_M
        low_m[2] = _GROUND_CLEARANCE_M
        return low_m, high_m


def as_built(rig: Rig, rng: np.random.Generator) -> dict[str, RigidTransform]:
    """Return ``T_base_<lidar>`` of one vehicle, each about 2 cm and 1 degree away from the drawing."""
    return {mount.name: _disturbed(mount.T_base_lidar, rng, _BUILD_SIGMA_M, _BUILD_SIGMA_RAD) for mount in rig.mounts}


def with_drawing_error(T_base_lidar: RigidTransform, rng: np.random.Generator) -> RigidTransform:
    """Return the pose for the recording's static transforms, which is off by about 5 cm and 2 degrees."""
    return _disturbed(T_base_lidar, rng, _DRAWING_SIGMA_M, _DRAWING_SIGMA_RAD)


def _disturbed(pose: RigidTransform, rng: np.random.Generator, sigma_m: float, sigma_rad: float) -> RigidTransform:
    shift_m = rng.normal(scale=sigma_m, size=3).tolist()
    turn_rad = rng.normal(scale=sigma_rad, size=3).tolist()
    return pose @ RigidTransform.from_xyz_rpy(pose.source, pose.source, shift_m, turn_rad)


def car(roof_height_m: float, roof_length_m: float, roof_width_m: float) -> Mesh:
    """Build a hull of 4.6 m by 1.8 m with a cabin whose roof carries the LiDARs."""
    hull = tapered_box((-2.3, 2.3, -0.9, 0.9), (-2.25, 2.1, -0.88, 0.88), 0.3, 0.55 * roof_height_m)
    foot = (-0.5 * roof_length_m - 0.25, 0.5 * roof_length_m + 0.5, -0.86, 0.86)
    roof = (-0.5 * roof_length_m, 0.5 * roof_length_m, -0.5 * roof_width_m, 0.5 * roof_width_m)
    return merged([hull, tapered_box(foot, roof, 0.55 * roof_height_m, roof_height_m)])


def shuttle(length_m: float, width_m: float, height_m: float) -> Mesh:
    """Build a small bus: one box with rounded shoulders."""
    half_x_m, half_y_m = length_m / 2.0, width_m / 2.0
    side = (-half_x_m, half_x_m, -half_y_m, half_y_m)
    roof = (-half_x_m + 0.1, half_x_m - 0.1, -half_y_m + 0.1, half_y_m - 0.1)
    return merged([tapered_box(side, side, 0.3, height_m - 0.2), tapered_box(side, roof, height_m - 0.2, height_m)])


def articulated_truck() -> Mesh:
    """Build a tractor with a straight trailer, 12.6 m long and low enough for a garage, with arms for its mirrors."""
    cab = tapered_box((3.3, 6.3, -1.2, 1.2), (3.4, 6.0, -1.15, 1.15), 0.5, 2.25)
    trailer = box((-6.3, -1.22, 0.9), (2.7, 1.22, 2.15))
    chassis = box((-6.0, -0.5, 0.5), (6.0, 0.5, 0.9))
    arms = box((5.46, -1.36, 1.9), (5.54, 1.36, 1.96))
    return merged([cab, trailer, chassis, arms, *wheels((-5.2, -3.9, 3.0, 5.2), 0.85, 1.15, 0.5)])


def _outwards(
    name: str, sensor: SensorModel, edge_m: tuple[float, float, float], pitch_deg: float, yaw_deg: float
) -> Mount:
    """Mount a LiDAR that looks outwards from an ellipse with two half axes and a height."""
    yaw_rad = np.deg2rad(yaw_deg)
    xyz_m = (edge_m[0] * float(np.cos(yaw_rad)), edge_m[1] * float(np.sin(yaw_rad)), edge_m[2])
    return Mount(name, sensor, xyz_m, (0.0, pitch_deg, yaw_deg))


def chain_rig(overlap_deg: float) -> Rig:
    """Build a rig of four narrow LiDARs on the roof; neighbours overlap by that angle."""
    step_deg = NARROW.pattern.horizontal_fov_deg - overlap_deg
    mounts = []
    for index, name in enumerate(("right", "front_right", "front_left", "left")):
        yaw_deg = step_deg * (index - 1.5)
        mounts.append(_outwards(name, NARROW, (0.3, 0.3, 1.95), 4.0 + 2.0 * (index % 2), yaw_deg))
    return Rig("chain", tuple(mounts), car(1.7, 1.2, 1.1))


# Two 128-channel spinning LiDARs at the sides and two 120-degree solid-state LiDARs at the ends, all tilted.
EDGAR = Rig(
    "edgar",
    (
        Mount("front", FALCON, (1.45, 0.0, 2.12), (1.0, 6.0, 0.0)),
        Mount("left", OS1_128, (0.15, 0.72, 2.14), (2.0, 18.0, 88.0)),
        Mount("rear", FALCON, (-1.45, 0.0, 2.12), (-1.0, 8.0, 180.0)),
        Mount("right", OS1_128, (0.15, -0.72, 2.14), (-3.0, 17.0, -91.0)),
    ),
    car(1.95, 2.7, 1.5),
)
# 128-channel spinning, 16-channel spinning, rosette and frequency-modulated solid-state LiDARs, close together.
HELIPR = Rig(
    "helipr",
    (
        Mount("aeva", AERIES_II, (0.65, -0.22, 1.95), (0.5, 1.0, -1.0)),
        Mount("livox", AVIA, (0.75, 0.25, 2.10), (-0.5, 1.0, 1.5)),
        Mount("ouster", OS2_128, (0.0, 0.0, 2.20), (0.5, 0.5, 0.0)),
        Mount("velodyne", VLP_16, (-0.45, 0.05, 2.05), (0.0, -1.0, 2.0)),
    ),
    car(1.72, 1.7, 1.4),
)
# A 64-channel LiDAR on the roof and two 32-channel LiDARs at the sides, tilted by 45 degrees.
SIDES = Rig(
    "sides",
    (
        Mount("left", SIDE_32, (0.01, 0.57, 1.65), (-4.2, 45.1, 91.8)),
        Mount("right", SIDE_32, (-0.03, -0.56, 1.62), (-0.5, 45.8, -86.1)),
        Mount("top", ROOF_64, (0.0, 0.0, 2.05), (0.0, 0.0, 0.0)),
    ),
    car(1.52, 1.2, 1.0),
)
# Two narrow LiDARs that overlap, with a third that looks away from both.
BLIND = Rig(
    "blind",
    (
        Mount("front_left", NARROW, (1.0, 0.35, 1.9), (0.0, 5.0, 18.0)),
        Mount("front_right", NARROW, (1.0, -0.35, 1.9), (0.0, 6.0, -18.0)),
        Mount("rear", NARROW, (-1.0, 0.0, 1.9), (0.0, 6.0, 180.0)),
    ),
    car(1.7, 1.2, 1.1),
)

# Two 120-degree solid-state LiDARs at the ends, without a common view.
FRONT_BACK = Rig(
    "front_back",
    (
        Mount("front", FALCON, (1.9, 0.0, 1.2), (0.5, 3.0, 1.0)),
        Mount("rear", FALCON, (-1.5, 0.0, 1.9), (-0.5, 7.0, 180.0)),
    ),
    car(1.7, 1.2, 1.1),
)
# Four narrow solid-state LiDARs on the corners, without a common view.
CORNERS = Rig(
    "corners",
    tuple(
        Mount(name, SOLID_70, (x_m, y_m, z_m), (0.0, pitch_deg, yaw_deg))
        for name, x_m, y_m, z_m, pitch_deg, yaw_deg in (
            ("front_left", 2.15, 0.95, 0.95, 2.0, 46.0),
            ("front_right", 2.15, -0.95, 0.95, 3.0, -44.0),
            ("rear_left", -2.25, 0.98, 1.0, 2.0, 136.0),
            ("rear_right", -2.25, -0.98, 1.0, 3.0, -134.0),
        )
    ),
    car(1.7, 1.2, 1.1),
)
# Three narrow solid-state LiDARs on the roof that share 5 degrees each, and one for the road far ahead.
NARROW4 = Rig(
    "narrow4",
    (
        Mount("far", LONG_25, (1.0, 0.1, 1.85), (0.0, 2.0, 1.0)),
        Mount("front", SOLID_70, (1.0, -0.1, 1.85), (0.5, 5.0, -1.0)),
        Mount("left", SOLID_70, (0.4, 0.55, 1.85), (0.0, 6.0, 64.0)),
        Mount("right", SOLID_70, (0.4, -0.55, 1.85), (0.0, 5.0, -66.0)),
    ),
    car(1.7, 1.2, 1.1),
)


def _sectors(name: str, count: int, roof_edge_m: tuple[float, float, float], body: Mesh) -> Rig:
    """Build a rig of LiDARs that look outwards, at even angles, from the roof's edge."""
    yaws_deg = [360.0 * index / count for index in range(count)]
    mounts = [
        _outwards(f"at_{round(yaw_deg):03d}", FALCON, roof_edge_m, 5.0 + index % 3, yaw_deg)
        for index, yaw_deg in enumerate(yaws_deg)
    ]
    return Rig(name, tuple(mounts), body)


# Six 64-channel spinning LiDARs on a circle of 1.53 m, at different heights, most of them tilted: all see all around.
RING6 = Rig(
    "ring6",
    (
        Mount("front", OS1_64, (1.530, 0.0, 2.20), (0.0, 8.0, 0.0)),
        Mount("front_left", OS1_64, (0.765, 1.325, 2.15), (-12.0, 3.0, 60.0)),
        Mount("front_right", OS1_64, (0.765, -1.325, 2.15), (14.0, 0.0, -60.0)),
        Mount("rear", OS1_64, (-1.530, 0.0, 2.30), (0.0, -6.0, 180.0)),
        Mount("rear_left", OS1_64, (-0.765, 1.325, 2.25), (-2.0, 0.0, 120.0)),
        Mount("rear_right", OS1_64, (-0.765, -1.325, 2.10), (9.0, -4.0, -120.0)),
    ),
    shuttle(4.6, 2.4, 1.95),
)
SECTORS8 = _sectors("sectors8", 8, (1.6, 0.75, 2.12), car(1.95, 3.0, 1.4))
SECTORS20 = _sectors("sectors20", 20, (3.3, 0.95, 2.25), shuttle(7.0, 2.1, 2.1))


# 32-channel LiDARs on the mirrors, 128-channel ones on both roofs, 120-degree solid-state ones on the trailer's walls.
TRUCK = Rig(
    "truck",
    (
        Mount("mirror_left", SIDE_32, (5.5, 1.44, 2.0), (-2.0, 28.0, 80.0)),
        Mount("mirror_right", SIDE_32, (5.5, -1.44, 2.0), (1.0, 30.0, -80.0)),
        Mount("roof", OS1_128, (3.4, 0.0, 2.42), (0.0, 1.0, 0.0)),
        Mount("trailer_left", FALCON, (-0.2, 1.28, 1.7), (0.0, 5.0, 90.0)),
        Mount("trailer_rear", FALCON, (-6.36, 0.0, 1.9), (0.0, 7.0, 180.0)),
        Mount("trailer_right", FALCON, (-0.2, -1.28, 1.7), (0.0, 6.0, -90.0)),
        Mount("trailer_roof", OS1_128, (-2.8, 0.0, 2.36), (0.0, -1.0, 180.0)),
    ),
    articulated_truck(),
)
# A 120-degree solid-state LiDAR on the cab, narrow ones on the trailer's walls, without a common view.
TRAILER = Rig(
    "trailer",
    (
        Mount("cab", FALCON, (6.36, 0.0, 1.6), (0.0, 4.0, 0.0)),
        Mount("trailer_left", SOLID_70, (-4.0, 1.28, 1.7), (0.0, 5.0, 100.0)),
        Mount("trailer_rear", SOLID_70, (-6.36, 0.0, 1.9), (0.0, 7.0, 180.0)),
        Mount("trailer_right", SOLID_70, (-4.0, -1.28, 1.7), (0.0, 6.0, -100.0)),
    ),
    articulated_truck(),
)


RIGS: Mapping[str, Rig] = {
    rig.name: rig
    for rig in (
        BLIND,
        chain_rig(overlap_deg=22.5),
        CORNERS,
        EDGAR,
        FRONT_BACK,
        HELIPR,
        NARROW4,
        RING6,
        SECTORS8,
        SECTORS20,
        SIDES,
        TRAILER,
        TRUCK,
    )
}
