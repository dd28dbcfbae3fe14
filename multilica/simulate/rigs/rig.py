# SPDX-License-Identifier: Apache-2.0
"""A vehicle with its LiDARs, drawn and built."""

from dataclasses import dataclass

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.simulate.sensors import SensorModel
from multilica.simulate.shapes.mesh import Mesh

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
