# SPDX-License-Identifier: Apache-2.0
"""Result of a scene builder."""

from dataclasses import dataclass

from multilica.geometry import RigidTransform
from multilica.simulate.shapes.mesh import Mesh
from multilica.simulate.shapes.terrain import Terrain

__all__ = ["Scene"]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A scene with the pose of the vehicle in it.

    Args:
        mesh: all surfaces in the world frame, metres, z up.
        terrain: the ground that vehicles and pedestrians stand on.
        vehicle_xy_m: position of the vehicle's middle in the world frame.
        vehicle_yaw_rad: heading of the vehicle in the world frame.
        headroom_m: height above ground that is free for tall vehicles.
    """

    mesh: Mesh
    terrain: Terrain
    vehicle_xy_m: tuple[float, float]
    vehicle_yaw_rad: float
    headroom_m: float = 10.0

    @property
    def T_world_base(self) -> RigidTransform:  # noqa: N802 - the field's notation
        """Return the pose of the vehicle's base frame in the world frame."""
        return self.terrain.standing_pose(*self.vehicle_xy_m, self.vehicle_yaw_rad)
