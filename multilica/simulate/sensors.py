# SPDX-License-Identifier: Apache-2.0
"""Models of LiDARs; beams in the LiDAR's own frame: x forward, y left, z up."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from multilica.geometry import FloatArray


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


BeamPattern = SpinningPattern | RasterPattern | RosettePattern


@dataclass(frozen=True, slots=True)
class SensorModel:
    """Measuring properties of a LiDAR.

    Args:
        range_noise_m: standard deviation of a range.
        dropout: probability that a beam on a surface facing it does not return.
        grazing_cosine: cosine of the incidence angle at which 63 % of the beams return; below, they fade away.
    """

    pattern: BeamPattern
    max_range_m: float
    min_range_m: float = 0.4
    range_noise_m: float = 0.018
    dropout: float = 0.02
    grazing_cosine: float = 0.05
