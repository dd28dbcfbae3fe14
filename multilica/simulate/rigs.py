# SPDX-License-Identifier: Apache-2.0
"""Simulated vehicles with their LiDARs."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from multilica.geometry import RigidTransform
from multilica.simulate.sensors import RasterPattern, RosettePattern, SensorModel, SpinningPattern
from multilica.simulate.shapes.mesh import Mesh, merged, tapered_box

__all__ = ["BASE", "RIGS", "Mount", "Rig", "as_built", "fan", "misjudged", "vehicle_body"]

BASE = "base"
_BUILD_SIGMA_M, _BUILD_SIGMA_RAD = 0.02, float(np.deg2rad(1.0))
_DRAWING_SIGMA_M, _DRAWING_SIGMA_RAD = 0.05, float(np.deg2rad(2.0))

_OS1_128 = SensorModel(SpinningPattern(128, 1024, (-22.5, 22.5)), 90.0, 0.3)  # Ouster OS1-128
_OS2_128 = SensorModel(SpinningPattern(128, 1024, (-11.25, 11.25)), 120.0, 0.8)  # Ouster OS2-128
_VLP_16 = SensorModel(SpinningPattern(16, 1800, (-15.0, 15.0)), 90.0, 0.4, 0.015)  # Velodyne VLP-16
_ROOF_64 = SensorModel(SpinningPattern(64, 1800, (-25.0, 15.0)), 110.0, 0.5, 0.015)  # 64-channel roof LiDAR
_SIDE_32 = SensorModel(SpinningPattern(32, 900, (-32.0, 48.0)), 60.0, 0.3, 0.02, 0.03)  # 32-channel side LiDAR
_FALCON = SensorModel(RasterPattern(104, 640, 120.0, 25.0), 120.0, 0.5, 0.02, 0.02)  # Seyond Falcon
_AVIA = SensorModel(RosettePattern(24_000, 70.4, 77.2), 100.0, 0.5, 0.02, 0.03)  # Livox Avia
_AERIES_II = SensorModel(RasterPattern(64, 800, 120.0, 19.2), 120.0, 0.8, 0.016, 0.03)  # Aeva Aeries II
_NARROW = SensorModel(RasterPattern(120, 400, 70.0, 30.0), 90.0, 0.4, 0.018, 0.02)  # narrow solid-state LiDAR


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


@dataclass(frozen=True, slots=True)
class Rig:
    """A vehicle with its LiDARs; `roof_m` is height, length and width of the roof."""

    name: str
    mounts: tuple[Mount, ...]
    roof_m: tuple[float, float, float]


def as_built(rig: Rig, rng: np.random.Generator) -> dict[str, RigidTransform]:
    """Return ``T_base_<lidar>`` of one vehicle, each about 2 cm and 1 degree away from the drawing."""
    return {mount.name: _disturbed(mount.T_base_lidar, rng, _BUILD_SIGMA_M, _BUILD_SIGMA_RAD) for mount in rig.mounts}


def misjudged(T_base_lidar: RigidTransform, rng: np.random.Generator) -> RigidTransform:
    """Return the pose for the recording's static transforms, which is off by about 5 cm and 2 degrees."""
    return _disturbed(T_base_lidar, rng, _DRAWING_SIGMA_M, _DRAWING_SIGMA_RAD)


def _disturbed(pose: RigidTransform, rng: np.random.Generator, sigma_m: float, sigma_rad: float) -> RigidTransform:
    shift_m = rng.normal(scale=sigma_m, size=3).tolist()
    turn_rad = rng.normal(scale=sigma_rad, size=3).tolist()
    return pose @ RigidTransform.from_xyz_rpy(pose.source, pose.source, shift_m, turn_rad)


def vehicle_body(rig: Rig) -> Mesh:
    """Build the vehicle in the base frame: a hull with a cabin whose roof carries the LiDARs."""
    height_m, length_m, width_m = rig.roof_m
    hull = tapered_box((-2.3, 2.3, -0.9, 0.9), (-2.25, 2.1, -0.88, 0.88), 0.3, 0.55 * height_m)
    foot = (-0.5 * length_m - 0.25, 0.5 * length_m + 0.5, -0.86, 0.86)
    roof = (-0.5 * length_m, 0.5 * length_m, -0.5 * width_m, 0.5 * width_m)
    return merged([hull, tapered_box(foot, roof, 0.55 * height_m, height_m)])


def fan(overlap_deg: float) -> Rig:
    """Build a rig of four narrow LiDARs on the roof, of which neighbours overlap by that angle."""
    step_deg = _NARROW.pattern.horizontal_fov_deg - overlap_deg
    mounts = []
    for index, name in enumerate(("right", "front_right", "front_left", "left")):
        yaw_deg = step_deg * (index - 1.5)
        yaw_rad = np.deg2rad(yaw_deg)
        xyz_m = (0.3 * float(np.cos(yaw_rad)), 0.3 * float(np.sin(yaw_rad)), 1.95)
        mounts.append(Mount(name, _NARROW, xyz_m, (0.0, 4.0 + 2.0 * (index % 2), yaw_deg)))
    return Rig("chain", tuple(mounts), (1.7, 1.2, 1.1))


# Two 128-channel spinning LiDARs at the sides and two 120-degree solid-state LiDARs at the ends, all tilted.
_EDGAR = Rig(
    "edgar",
    (
        Mount("front", _FALCON, (1.45, 0.0, 2.12), (1.0, 6.0, 0.0)),
        Mount("left", _OS1_128, (0.15, 0.72, 2.14), (2.0, 18.0, 88.0)),
        Mount("rear", _FALCON, (-1.45, 0.0, 2.12), (-1.0, 8.0, 180.0)),
        Mount("right", _OS1_128, (0.15, -0.72, 2.14), (-3.0, 17.0, -91.0)),
    ),
    (1.95, 2.7, 1.5),
)
# 128-channel spinning, 16-channel spinning, rosette and frequency-modulated solid-state LiDARs, close together.
_HELIPR = Rig(
    "helipr",
    (
        Mount("aeva", _AERIES_II, (0.65, -0.22, 1.95), (0.5, 1.0, -1.0)),
        Mount("livox", _AVIA, (0.75, 0.25, 2.10), (-0.5, 1.0, 1.5)),
        Mount("ouster", _OS2_128, (0.0, 0.0, 2.20), (0.5, 0.5, 0.0)),
        Mount("velodyne", _VLP_16, (-0.45, 0.05, 2.05), (0.0, -1.0, 2.0)),
    ),
    (1.72, 1.7, 1.4),
)
# A 64-channel LiDAR on the roof and two 32-channel LiDARs at the sides, tilted by 45 degrees.
_SIDES = Rig(
    "sides",
    (
        Mount("left", _SIDE_32, (0.01, 0.57, 1.65), (-4.2, 45.1, 91.8)),
        Mount("right", _SIDE_32, (-0.03, -0.56, 1.62), (-0.5, 45.8, -86.1)),
        Mount("top", _ROOF_64, (0.0, 0.0, 2.05), (0.0, 0.0, 0.0)),
    ),
    (1.52, 1.2, 1.0),
)
# Two narrow LiDARs that overlap, with a third that looks away from both.
_BLIND = Rig(
    "blind",
    (
        Mount("front_left", _NARROW, (1.0, 0.35, 1.9), (0.0, 5.0, 18.0)),
        Mount("front_right", _NARROW, (1.0, -0.35, 1.9), (0.0, 6.0, -18.0)),
        Mount("rear", _NARROW, (-1.0, 0.0, 1.9), (0.0, 6.0, 180.0)),
    ),
    (1.7, 1.2, 1.1),
)

RIGS: Mapping[str, Rig] = {rig.name: rig for rig in (_BLIND, fan(overlap_deg=22.5), _EDGAR, _HELIPR, _SIDES)}
