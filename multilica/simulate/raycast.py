# SPDX-License-Identifier: Apache-2.0
"""Ray casting of LiDAR beams into meshes."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.lazy_open3d import open3d_for
from multilica.simulate.sensors import SensorModel
from multilica.simulate.shapes.mesh import Mesh

o3d = open3d_for("A simulation")


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """First surfaces that beams hit.

    Args:
        ranges_m: (N,) to the first surface, inf where there is none.
        cosines: (N,) of the incidence angle, 1 for a surface at a right angle.
    """

    ranges_m: FloatArray
    cosines: FloatArray


class Surroundings:
    """A mesh that beams can be cast into, in the frame in which the LiDAR's pose is given."""

    def __init__(self, mesh: Mesh) -> None:
        self._scene = o3d.t.geometry.RaycastingScene()
        self._tensor = o3d.core.Tensor
        if len(mesh.triangles):
            vertices = self._tensor(mesh.vertices_m.astype(np.float32))
            self._scene.add_triangles(vertices, self._tensor(mesh.triangles.astype(np.uint32)))

    def cast(self, T_frame_lidar: RigidTransform, directions: FloatArray) -> Hits:
        """Return the first hits of beams (N, 3) that leave the LiDAR's origin."""
        turned = T_frame_lidar.rotate(directions).astype(np.float32)
        origins = np.broadcast_to(T_frame_lidar.xyz_m.astype(np.float32), turned.shape)
        found = self._scene.cast_rays(self._tensor(np.hstack([origins, turned])))
        ranges = found["t_hit"].numpy().astype(np.float64)
        normals = found["primitive_normals"].numpy()
        return Hits(ranges, np.abs(np.einsum("ij,ij->i", normals, turned)).astype(np.float64))


def nearer(first: Hits, second: Hits) -> Hits:
    """Return the nearer hit of each beam."""
    closer = second.ranges_m < first.ranges_m
    return Hits(np.where(closer, second.ranges_m, first.ranges_m), np.where(closer, second.cosines, first.cosines))


def measure(sensor: SensorModel, hits: Hits, rng: np.random.Generator) -> FloatArray:
    """Return the reported ranges (N,), nan where the LiDAR reports nothing.

    Beams are lost outside the LiDAR's range and at random, more often the more they graze a surface.
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
    """Return the points (M, 3) of the beams that returned, in the LiDAR's frame."""
    kept = np.isfinite(ranges_m)
    return (directions[kept] * ranges_m[kept, None]).astype(np.float32)
