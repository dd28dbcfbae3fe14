# SPDX-License-Identifier: Apache-2.0
"""Triangle meshes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from multilica.geometry import FloatArray, RigidTransform, read_only

__all__ = ["Mesh", "facing_quads", "merged", "quads"]

IndexArray = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles; surfaces may intersect and need not be closed.

    Args:
        vertices_m: (V, 3).
        triangles: (T, 3) indices of vertices.
    """

    vertices_m: FloatArray
    triangles: IndexArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "vertices_m", read_only(np.reshape(self.vertices_m, (-1, 3)), np.float64))
        object.__setattr__(self, "triangles", read_only(np.reshape(self.triangles, (-1, 3)), np.int64))

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
