# SPDX-License-Identifier: Apache-2.0
"""Beam patterns of LiDARs in their own frame: x forward, y left, z up."""

from dataclasses import dataclass

import numpy as np

from multilica.geometry import FloatArray

__all__ = ["BeamPattern", "RasterPattern", "RosettePattern", "SpinningPattern", "unit_directions"]


def unit_directions(azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
    """Compute unit vectors (N, 3) from angles of a common shape."""
    azimuth, elevation = np.broadcast_arrays(azimuth_rad, elevation_rad)
    flat = np.cos(elevation)
    return np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1).reshape(-1, 3)


@dataclass(frozen=True, slots=True)
class SpinningPattern:
    """Channels that rotate about z; each frame starts at a random phase of a column.

    Args:
        columns: firings per turn.
        elevation_deg: lowest and highest channel.
    """

    channels: int
    columns: int
    elevation_deg: tuple[float, float]

    @property
    def horizontal_fov_deg(self) -> float:
        """Return the full angle about z."""
        return 360.0

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

    @property
    def elevation_deg(self) -> tuple[float, float]:
        """Return the lowest and highest elevation."""
        return -self.vertical_fov_deg / 2.0, self.vertical_fov_deg / 2.0

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
    """Petals of two counter-rotating prisms with a stack of lasers; the figure continues from frame to frame.

    Args:
        beams: firings per frame, over all lasers.
        lasers: lasers above one another.
        laser_pitch_deg: distance between lasers.
    """

    beams: int
    horizontal_fov_deg: float
    vertical_fov_deg: float
    lasers: int = 6
    laser_pitch_deg: float = 0.25
    frame_s: float = 0.1
    prism_hz: tuple[float, float] = (124.3, -78.7)

    @property
    def elevation_deg(self) -> tuple[float, float]:
        """Return the lowest and highest elevation."""
        return -self.vertical_fov_deg / 2.0, self.vertical_fov_deg / 2.0

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
