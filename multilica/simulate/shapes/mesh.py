# SPDX-License-Identifier: Apache-2.0
"""Triangle meshes of simple bodies."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from multilica.geometry import FloatArray, RigidTransform, read_only

IndexArray = npt.NDArray[np.int64]
Point = Sequence[float]
Rectangle = tuple[float, float, float, float]
"""(x0, x1, y0, y1) in metres."""

_FACES = np.array([[0, 1, 2, 3], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6], [3, 0, 4, 7]])


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles (T, 3) of vertices (V, 3); surfaces may intersect and need not be closed."""

    vertices_m: FloatArray
    triangles: IndexArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices_m", read_only(np.reshape(self.vertices_m, (-1, 3)), np.float64))
        object.__setattr__(self, "triangles", read_only(np.reshape(self.triangles, (-1, 3)), np.int64))

    @property
    def length_m(self) -> float:
        """Return the longest side of the box around it, parallel to the axes."""
        return float(np.ptp(self.vertices_m, axis=0).max())

    def moved(self, x_m: float = 0.0, y_m: float = 0.0, z_m: float = 0.0, yaw_rad: float = 0.0) -> Mesh:
        """Rotate the mesh about its z axis, then shift it."""
        return self.rotated((0.0, 0.0, yaw_rad), (x_m, y_m, z_m))

    def rotated(self, rpy_rad: tuple[float, float, float], xyz_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Mesh:
        """Rotate the mesh by extrinsic roll, pitch, yaw, then shift it."""
        rotation = Rotation.from_euler("xyz", rpy_rad).as_matrix()
        return Mesh(self.vertices_m @ rotation.T + np.asarray(xyz_m), self.triangles)

    def transformed(self, T_target_source: RigidTransform) -> Mesh:
        """Transform the mesh from the source to the target frame."""
        return Mesh(T_target_source.apply(self.vertices_m), self.triangles)


def merged(meshes: Iterable[Mesh]) -> Mesh:
    """Merge meshes into one, keeping the order of their triangles."""
    parts = list(meshes)
    if not parts:
        return Mesh(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))
    starts = np.cumsum([0, *(len(part.vertices_m) for part in parts[:-1])])
    triangles = [part.triangles + start for part, start in zip(parts, starts, strict=True)]
    return Mesh(np.concatenate([part.vertices_m for part in parts]), np.concatenate(triangles))


def repeated(mesh: Mesh, spots_x_m: FloatArray) -> Mesh:
    """Merge copies of the mesh, each shifted along x to one of the spots (N,)."""
    shifts_m = np.asarray(spots_x_m, dtype=np.float64)[:, None] * [1.0, 0.0, 0.0]
    starts = len(mesh.vertices_m) * np.arange(len(shifts_m))
    return Mesh(mesh.vertices_m + shifts_m[:, None], mesh.triangles + starts[:, None, None])


def reaches_into(mesh: Mesh, low_m: FloatArray, high_m: FloatArray) -> bool:
    """Return whether any triangle touches the axis-parallel box between two corners (3,), by separating axes."""
    half_m = (high_m - low_m) / 2.0
    corners = mesh.vertices_m[mesh.triangles] - (low_m + high_m) / 2.0
    corners = corners[((corners.max(axis=1) >= -half_m) & (corners.min(axis=1) <= half_m)).all(axis=1)]
    edges = np.roll(corners, -1, axis=1) - corners
    across = np.cross(edges[:, :, None], np.eye(3)).reshape(-1, 9, 3)
    axes = np.concatenate([np.cross(edges[:, :1], edges[:, 1:2]), across], axis=1)
    reach = np.abs(axes) @ half_m
    shadow = axes @ corners.swapaxes(1, 2)
    apart = (shadow.min(axis=2) > reach) | (shadow.max(axis=2) < -reach)
    return not bool(apart.any(axis=1).all())


def quads(corners_m: npt.ArrayLike) -> Mesh:
    """Build quadrilaterals from their corners (Q, 4, 3) in circular order."""
    corners = np.asarray(corners_m, dtype=np.float64).reshape(-1, 4, 3)
    first = 4 * np.arange(len(corners))[:, None, None]
    triangles = first + np.array([[0, 1, 2], [0, 2, 3]])
    return Mesh(corners.reshape(-1, 3), triangles.reshape(-1, 3))


def facing_quads(loop_a_m: FloatArray, loop_b_m: FloatArray) -> Mesh:
    """Build the band between two polylines (K, 3), one quadrilateral per segment."""
    corners = np.stack([loop_a_m[:-1], loop_a_m[1:], loop_b_m[1:], loop_b_m[:-1]], axis=1)
    return quads(corners)


def box(low_m: Point, high_m: Point) -> Mesh:
    """Build an axis-parallel box between two corners."""
    rectangle = (low_m[0], high_m[0], low_m[1], high_m[1])
    return tapered_box(rectangle, rectangle, low_m[2], high_m[2])


def tapered_box(bottom_m: Rectangle, top_m: Rectangle, z0_m: float, z1_m: float) -> Mesh:
    """Build a box whose bottom and top rectangles differ: car bodies, greenhouses, heaps."""
    corners = [
        [x, y, z]
        for (x0, x1, y0, y1), z in ((bottom_m, z0_m), (top_m, z1_m))
        for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    ]
    return quads(np.array(corners)[_FACES])


def cylinder(radius_m: float, z0_m: float, z1_m: float, top_radius_m: float | None = None, sides: int = 12) -> Mesh:
    """Build an upright cylinder about the z axis, or a cone if the top radius differs; closed by its caps."""
    bottom = _circle(radius_m, z0_m, sides)
    top = _circle(radius_m if top_radius_m is None else top_radius_m, z1_m, sides)
    caps = [facing_quads(np.broadcast_to(ring.mean(axis=0), ring.shape), ring) for ring in (bottom, top)]
    return merged([facing_quads(bottom, top), *caps])


def _circle(radius_m: float, z_m: float, sides: int) -> FloatArray:
    circle = np.full((sides + 1, 3), z_m)
    circle[:, :2] = radius_m * _unit_circle(sides)
    return circle


@cache
def _unit_circle(sides: int) -> FloatArray:
    angles = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    return np.column_stack([np.cos(angles), np.sin(angles)])


def tube(start_m: Point, end_m: Point, radius_m: float, sides: int = 8) -> Mesh:
    """Build a cylinder between any two points: pipes, rails, branches."""
    start = np.asarray(start_m, dtype=np.float64)
    axis = np.asarray(end_m, dtype=np.float64) - start
    length_m = float(np.linalg.norm(axis))
    pitch = float(np.arctan2(np.hypot(axis[0], axis[1]), axis[2]))
    yaw = float(np.arctan2(axis[1], axis[0]))
    return cylinder(radius_m, 0.0, length_m, sides=sides).rotated((0.0, pitch, yaw), (start[0], start[1], start[2]))


def sphere(radii_m: Point, centre_m: Point, sides: int = 10) -> Mesh:
    """Build an ellipsoid with its axes along x, y, z."""
    polar = np.linspace(0.0, np.pi, sides // 2 + 1)
    around = np.linspace(0.0, 2.0 * np.pi, sides + 1)
    ring, turn = np.meshgrid(polar, around, indexing="ij")
    unit = np.stack([np.sin(ring) * np.cos(turn), np.sin(ring) * np.sin(turn), np.cos(ring)], axis=-1)
    points = unit * np.asarray(radii_m) + np.asarray(centre_m)
    return merged([facing_quads(points[row], points[row + 1]) for row in range(len(polar) - 1)])


def extrusion(profile_yz_m: npt.ArrayLike, x0_m: float, x1_m: float) -> Mesh:
    """Extrude a polyline (K, 2) of y and z along x: arches, kerbs, hedges."""
    profile = np.asarray(profile_yz_m, dtype=np.float64)
    ends = [np.column_stack([np.full(len(profile), x), profile]) for x in (x0_m, x1_m)]
    return facing_quads(ends[0], ends[1])
