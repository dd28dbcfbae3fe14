# SPDX-License-Identifier: Apache-2.0
"""Beams cast into meshes, turned into what a LiDAR would report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import open3d as o3d

from multilica.geometry import FloatArray, RigidTransform
from multilica.simulate.sensors import SensorModel
from multilica.simulate.shapes.mesh import Mesh

__all__ = ["Hits", "Surroundings", "cast", "measure", "nearer", "returned_points"]


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """Where beams end.

    Args:
        ranges_m: (N,) to the first surface, inf where there is none.
        cosines: (N,) of the incidence angle, 1 for a surface faced squarely.
    """

    ranges_m: FloatArray
    cosines: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Surroundings:
    """Meshes of one frame of reference, ready for casting."""

    frame: str
    caster: Any

    @classmethod
    def of(cls, frame: str, mesh: Mesh) -> Surroundings:
        """Build the search tree of a mesh."""
        caster = o3d.t.geometry.RaycastingScene()
        if len(mesh.triangles):
            vertices = o3d.core.Tensor(mesh.vertices_m.astype(np.float32))
            caster.add_triangles(vertices, o3d.core.Tensor(mesh.triangles.astype(np.uint32)))
        return cls(frame, caster)


def cast(surroundings: Surroundings, T_frame_lidar: RigidTransform, directions: FloatArray) -> Hits:
    """First hits of beams (N, 3) that leave the LiDAR's origin."""
    turned = T_frame_lidar.rotate(directions).astype(np.float32)
    origins = np.broadcast_to(T_frame_lidar.xyz_m.astype(np.float32), turned.shape)
    answer = surroundings.caster.cast_rays(o3d.core.Tensor(np.hstack([origins, turned])))
    ranges = answer["t_hit"].numpy().astype(np.float64)
    normals = answer["primitive_normals"].numpy()
    return Hits(ranges, np.abs(np.einsum("ij,ij->i", normals, turned)).astype(np.float64))


def nearer(first: Hits, second: Hits) -> Hits:
    """Beam by beam, whichever hit comes first."""
    closer = second.ranges_m < first.ranges_m
    return Hits(np.where(closer, second.ranges_m, first.ranges_m), np.where(closer, second.cosines, first.cosines))


def measure(sensor: SensorModel, hits: Hits, rng: np.random.Generator) -> FloatArray:
    """Reported ranges (N,), nan where the LiDAR reports nothing.

    Beams are lost at random, more of them the more they graze a surface, and outside the LiDAR's range.
    """
    count = len(hits.ranges_m)
    reported = np.where(np.isfinite(hits.ranges_m), hits.ranges_m, np.nan)
    reported = reported + rng.normal(scale=sensor.range_noise_m, size=count)
    returns = (1.0 - sensor.dropout) * -np.expm1(-hits.cosines / sensor.grazing_cosine)
    lost = rng.random(count) > returns
    outside = ~((reported >= sensor.min_range_m) & (reported <= sensor.max_range_m))
    reported[lost | outside] = np.nan
    return reported


def returned_points(directions: FloatArray, ranges_m: FloatArray) -> npt.NDArray[np.float32]:
    """Points (M, 3) in the LiDAR's frame of the beams that returned."""
    kept = np.isfinite(ranges_m)
    return (directions[kept] * ranges_m[kept, None]).astype(np.float32)
