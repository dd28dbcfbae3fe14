# SPDX-License-Identifier: Apache-2.0
"""Models of LiDARs and their measurements; beams in the LiDAR's own frame: x forward, y left, z up."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray, RigidTransform
from multilica.registration.lazy_open3d import LazyOpen3d
from multilica.simulate.shapes.mesh import Mesh

o3d = LazyOpen3d("A simulation")

RingArray = npt.NDArray[np.int64]
# Share of the light that most surfaces of a road scene send back.
USUAL_REFLECTIVITY = 0.3


def unit_directions(azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
    """Compute unit vectors (N, 3) from angles of a common shape."""
    azimuth, elevation = np.broadcast_arrays(azimuth_rad, elevation_rad)
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)


@dataclass(frozen=True, slots=True)
class SpinningPattern:
    """Channels that rotate about z and fire once per column; each frame starts at a random phase of a column."""

    channels: int
    columns: int
    elevation_deg: tuple[float, float]
    horizontal_fov_deg: ClassVar[float] = 360.0

    def directions(self, frame: int, rng: np.random.Generator) -> FloatArray:
        """Return (columns * channels, 3) unit vectors of one turn."""
        del frame
        azimuth = 2.0 * np.pi * (np.arange(self.columns) + rng.random()) / self.columns
        elevation = np.deg2rad(np.linspace(*self.elevation_deg, self.channels))
        return unit_directions(azimuth[:, None], elevation[None, :])

    @property
    def rings(self) -> RingArray:
        """(columns * channels,) channel of each beam."""
        return np.tile(np.arange(self.channels), self.columns)


@dataclass(frozen=True, slots=True)
class RasterPattern:
    """Rows and columns over a rectangular field of view, shifted within one cell from frame to frame."""

    rows: int
    columns: int
    horizontal_fov_deg: float
    vertical_fov_deg: float

    def directions(self, frame: int, rng: np.random.Generator) -> FloatArray:
        """Return (rows * columns, 3) unit vectors of one frame."""
        del frame
        column = (np.arange(self.columns) + rng.random()) / self.columns - 0.5
        row = (np.arange(self.rows) + rng.random()) / self.rows - 0.5
        azimuth = np.deg2rad(self.horizontal_fov_deg) * column
        elevation = np.deg2rad(self.vertical_fov_deg) * row
        return unit_directions(azimuth[None, :], elevation[:, None])

    @property
    def rings(self) -> RingArray:
        """(rows * columns,) row of each beam."""
        return np.repeat(np.arange(self.rows), self.columns)


@dataclass(frozen=True, slots=True)
class RosettePattern:
    """Petals of two counter-rotating prisms with a stack of lasers; the figure continues from frame to frame."""

    beams: int
    horizontal_fov_deg: float
    vertical_fov_deg: float
    lasers: int = 6
    laser_pitch_deg: float = 0.25
    frame_s: float = 0.1
    prism_hz: tuple[float, float] = (124.3, -78.7)

    def directions(self, frame: int, rng: np.random.Generator) -> FloatArray:
        """Return (beams, 3) unit vectors of one frame."""
        del rng
        firings = self.beams // self.lasers
        time_s = self.frame_s * (frame + np.arange(firings) / firings)
        turns = [2.0 * np.pi * hz * time_s for hz in self.prism_hz]
        sideways = (np.cos(turns[0]) + np.cos(turns[1])) / 2.0
        upwards = (np.sin(turns[0]) + np.sin(turns[1])) / 2.0
        stack_deg = self.laser_pitch_deg * (np.arange(self.lasers) - (self.lasers - 1) / 2.0)
        swing_deg = self.vertical_fov_deg / 2.0 - stack_deg[-1]
        azimuth = np.deg2rad(self.horizontal_fov_deg / 2.0 * sideways)
        elevation = np.deg2rad(swing_deg * upwards[:, None] + stack_deg[None, :])
        return unit_directions(azimuth[:, None], elevation)

    @property
    def rings(self) -> RingArray:
        """(beams,) laser of each beam."""
        return np.tile(np.arange(self.lasers), self.beams // self.lasers)


BeamPattern = SpinningPattern | RasterPattern | RosettePattern


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Errors of a LiDAR that do not change from frame to frame: standard deviations over the units of a model.

    The usual values are those of rotating LiDARs with a datasheet that states a range accuracy of 3 cm, read as three
    standard deviations.

    Args:
        range_m: of all ranges.
        ring_range_m: of the ranges of each ring, on top.
        range_scale: of the ranges, relative.
        glancing_m: of a range on a surface that the beam just grazes, against one that it meets head-on.
        reflectivity_m: of a range on a white surface against one on a black one.
        ring_elevation_deg, ring_azimuth_deg: of the direction of each ring.
    """

    range_m: float = 0.010
    ring_range_m: float = 0.008
    range_scale: float = 2e-4
    glancing_m: float = 0.005
    reflectivity_m: float = 0.005
    ring_elevation_deg: float = 0.03
    ring_azimuth_deg: float = 0.03


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Measuring properties of a LiDAR.

    Args:
        range_noise_m: standard deviation of a range.
        dropout: probability that a beam on a surface facing it does not return.
        grazing_cosine: cosine of the incidence angle at which 63 % of the beams return; below, they fade away.
        range_step_m: resolution of the reported ranges.
        beam_deg: full angle of the diverging beam.
        dark_range_m: range at which 90 % of the beams return from a surface of 10 % reflectivity.
    """

    pattern: BeamPattern
    max_range_m: float
    min_range_m: float = 0.4
    range_noise_m: float = 0.018
    dropout: float = 0.02
    grazing_cosine: float = 0.05
    range_step_m: float = 0.002
    beam_deg: float = 0.18
    dark_range_m: float = 80.0
    accuracy: Accuracy = Accuracy()


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """First surfaces that N beams meet.

    Args:
        ranges_m: (N,), inf where there is none.
        cosines: (N,) of the incidence angles.
        reflectivities: (N,) share of the light that a white, matt surface would send back; above 1: a retroreflector.
    """

    ranges_m: FloatArray
    cosines: FloatArray
    reflectivities: FloatArray


class Surroundings:
    """A mesh that beams can be cast into, in the frame in which the LiDAR's pose is given.

    Args:
        reflectivities: per triangle; None: all the usual one.
    """

    def __init__(self, mesh: Mesh, reflectivities: FloatArray | None = None) -> None:
        self._scene = o3d.t.geometry.RaycastingScene()
        self._tensor = o3d.core.Tensor
        if reflectivities is None:
            reflectivities = np.full(len(mesh.triangles), USUAL_REFLECTIVITY)
        self._reflectivities = np.append(reflectivities, USUAL_REFLECTIVITY)
        if len(mesh.triangles):
            vertices = self._tensor(mesh.vertices_m.astype(np.float32))
            self._scene.add_triangles(vertices, self._tensor(mesh.triangles.astype(np.uint32)))

    def cast(self, T_frame_lidar: RigidTransform, directions: FloatArray) -> Hits:
        """Return the first hits of beams (N, 3) that leave the LiDAR's origin."""
        return self.cast_rays(T_frame_lidar.xyz_m, T_frame_lidar.rotate(directions))

    def cast_rays(self, origins_m: FloatArray, directions: FloatArray) -> Hits:
        """Return the first hits of beams from one origin (3,) or one each (N, 3), with directions (N, 3)."""
        turned = directions.astype(np.float32)
        origins = np.broadcast_to(origins_m.astype(np.float32), turned.shape)
        found = self._scene.cast_rays(self._tensor(np.hstack([origins, turned])))
        ranges = found["t_hit"].numpy().astype(np.float64)
        normals = found["primitive_normals"].numpy()
        cosines = np.abs(np.einsum("ij,ij->i", normals, turned)).astype(np.float64)
        triangles = np.minimum(found["primitive_ids"].numpy(), len(self._reflectivities) - 1)
        return Hits(ranges, cosines, self._reflectivities[triangles])


def nearer(first: Hits, second: Hits) -> Hits:
    """Return the nearer hit of each beam."""
    closer = second.ranges_m < first.ranges_m
    return chosen(closer, second, first)


def chosen(mask: npt.NDArray[np.bool_], hits: Hits, others: Hits) -> Hits:
    """Return the hits where the mask (N,) says so, and the others elsewhere."""
    return Hits(
        np.where(mask, hits.ranges_m, others.ranges_m),
        np.where(mask, hits.cosines, others.cosines),
        np.where(mask, hits.reflectivities, others.reflectivities),
    )


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
