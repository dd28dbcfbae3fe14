# SPDX-License-Identifier: Apache-2.0
"""A scene on its terrain."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from multilica.errors import UsageError
from multilica.geometry import FloatArray, RigidTransform
from multilica.simulate.shapes.mesh import Mesh, facing_quads, merged, reaches_into

Wave = tuple[float, float, float, float]
"""Amplitude (m), kx, ky (rad/m) and phase (rad) of ``amplitude * sin(kx * x + ky * y + phase)``."""
Lane = tuple[float, float]
"""y (m) of the middle of a straight lane along x, and 1.0 if its traffic goes along x, -1.0 if against."""


@dataclass(frozen=True, slots=True)
class Terrain:
    """A plane through the origin, with slopes in metres per metre and waves on it."""

    slope_x: float = 0.0
    slope_y: float = 0.0
    waves: tuple[Wave, ...] = ()

    def height_m(self, x_m: FloatArray, y_m: FloatArray) -> FloatArray:
        """Return the height of the ground at points of any common shape."""
        height = self.slope_x * np.asarray(x_m) + self.slope_y * np.asarray(y_m)
        for amplitude_m, kx, ky, phase_rad in self.waves:
            height = height + amplitude_m * np.sin(kx * x_m + ky * y_m + phase_rad)
        return np.asarray(height)

    def place(self, mesh: Mesh, x_m: float, y_m: float, yaw_rad: float = 0.0, sunk_m: float = 0.0) -> Mesh:
        """Place the mesh upright on the ground, its origin `sunk_m` below it."""
        ground_m = float(self.height_m(np.asarray(x_m), np.asarray(y_m)))
        return mesh.moved(x_m, y_m, ground_m - sunk_m, yaw_rad)

    def drape(self, mesh: Mesh) -> Mesh:
        """Raise each vertex by the height of the ground below it: kerbs, hedges, fences."""
        lift = self.height_m(mesh.vertices_m[:, 0], mesh.vertices_m[:, 1])
        return Mesh(mesh.vertices_m + np.column_stack([0.0 * lift, 0.0 * lift, lift]), mesh.triangles)

    def surface(self, x_m: FloatArray, y_m: FloatArray) -> Mesh:
        """Build the ground over the grid of x (X,) and y (Y,)."""
        x, y = np.meshgrid(x_m, y_m, indexing="ij")
        points = np.stack([x, y, self.height_m(x, y)], axis=-1)
        return merged([facing_quads(points[row], points[row + 1]) for row in range(len(points) - 1)])

    def standing_pose(self, x_m: float, y_m: float, yaw_rad: float) -> RigidTransform:
        """Return ``T_world_base`` of a vehicle that stands there on its four wheels."""
        wheels = np.array([[a, b] for a in (-1.4, 1.4) for b in (-0.8, 0.8)])
        turn = np.array([[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]])
        contacts = wheels @ turn.T + [x_m, y_m]
        heights = self.height_m(contacts[:, 0], contacts[:, 1])
        plane = np.linalg.lstsq(np.column_stack([contacts - [x_m, y_m], np.ones(4)]), heights)[0]
        z_axis = np.array([-plane[0], -plane[1], 1.0]) / np.linalg.norm([plane[0], plane[1], 1.0])
        x_axis = np.append(turn[:, 0], turn[:, 0] @ plane[:2])
        x_axis /= np.linalg.norm(x_axis)
        rotation = np.column_stack([x_axis, np.cross(z_axis, x_axis), z_axis])
        return RigidTransform.from_rotation_translation("world", "base", rotation, [x_m, y_m, plane[2]])


FLAT = Terrain()
# Longer than pipes and hedges, shorter than fences and the ground.
_LONGEST_LEFT_OUT_M = 100.0


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """All bodies and the vehicle's middle in the world frame, z up; tall vehicles have the headroom above ground.

    If there are lanes, the vehicle stands in one of them and heads along x.
    """

    parts: tuple[Mesh, ...]
    terrain: Terrain
    vehicle_xy_m: tuple[float, float]
    vehicle_yaw_rad: float
    headroom_m: float = 10.0
    lanes: tuple[Lane, ...] = ()

    @property
    def T_world_base(self) -> RigidTransform:  # noqa: N802 - the field's notation
        """Return the pose of the vehicle's base frame in the world frame."""
        return self.terrain.standing_pose(*self.vehicle_xy_m, self.vehicle_yaw_rad)

    def with_room_for(self, low_m: FloatArray, high_m: FloatArray) -> Scene:
        """Leave out each body that reaches into the vehicle's box, from corner to corner (3,) in the base frame.

        Raises:
            UsageError: a wall, a fence or the ground is in the way.
        """
        T_base_world = self.T_world_base.inverse()
        reaching = [reaches_into(part.transformed(T_base_world), low_m, high_m) for part in self.parts]
        longest_m = max((part.length_m for part, inside in zip(self.parts, reaching, strict=True) if inside), default=0)
        if longest_m > _LONGEST_LEFT_OUT_M:
            raise UsageError(
                f"A vehicle of {high_m[0] - low_m[0]:.0f} m has no room here: a structure {longest_m:.0f} m long is in "
                "its way; choose another seed."
            )
        return replace(self, parts=tuple(part for part, inside in zip(self.parts, reaching, strict=True) if not inside))


def rolling_waves(
    rng: np.random.Generator, count: int, lengths_m: tuple[float, float], steepness: float
) -> tuple[Wave, ...]:
    """Draw waves of random direction, of lengths in a range, whose amplitude is the length times the steepness."""
    lengths = rng.uniform(*lengths_m, size=count)
    angles = rng.uniform(0.0, 2.0 * np.pi, size=count)
    phases = rng.uniform(0.0, 2.0 * np.pi, size=count)
    k = 2.0 * np.pi / lengths
    columns = (steepness * lengths, k * np.cos(angles), k * np.sin(angles), phases)
    return tuple(zip(*(column.tolist() for column in columns), strict=True))
