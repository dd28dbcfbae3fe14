# SPDX-License-Identifier: Apache-2.0
"""One unit of a model of LiDAR: what it measures, with the errors that it was built with."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from multilica.geometry import FloatArray
from multilica.simulate.sensors import USUAL_REFLECTIVITY, Hits, SensorModel, chosen, measure, unit_directions

Cast = Callable[[FloatArray], Hits]
"""Casts beams (N, 3) of the LiDAR."""

# 90 % of the beams return at the range that a datasheet states for dark surfaces.
_SIGNAL_AT_DARK_RANGE = float(np.log(10.0))
_DARK_REFLECTIVITY = 0.1
# Within the length of a pulse of 5 ns, two echoes become one.
_PULSE_M = 0.75
# Light that a retroreflector scatters in the optics: half of the beams right beside it, none at three times the angle.
_BLOOM_DEG = 0.25
_BLOOM_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class LidarUnit:
    """A LiDAR with its own errors, the same in each frame.

    Args:
        range_bias_m: (rings,) is added to each range.
        range_scale: relative error of the ranges.
        glancing_m: is added to a range on a surface that the beam just grazes.
        reflectivity_m: by how much a range on a white surface is longer than one on a black surface.
        elevation_rad, azimuth_rad: (rings,) true direction of a beam less the reported one.
    """

    sensor: SensorModel
    range_bias_m: FloatArray
    range_scale: float
    glancing_m: float
    reflectivity_m: float
    elevation_rad: FloatArray
    azimuth_rad: FloatArray

    def measure(
        self, directions: FloatArray, cast: Cast, rng: np.random.Generator, optics: np.random.Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Measure along the directions (N, 3) that the LiDAR takes its beams to have.

        Args:
            rng: of the noise and of the beams that are lost by chance, as for an ideal LiDAR.
            optics: of all else.

        Returns:
            The reported ranges (N,), nan where nothing returns, and the intensities (N,) from 0 to 255.
        """
        rings = self.sensor.pattern.rings
        true = _turned(directions, self.azimuth_rad[rings], self.elevation_rad[rings])
        hits = self._blurred(true, cast, optics)
        ranges_m = measure(self.sensor, hits, rng)
        ranges_m[optics.random(len(ranges_m)) > self._returning(hits)] = np.nan
        bias_m = self.range_bias_m[rings] + self.glancing_m * (1.0 - hits.cosines)
        bias_m += self.reflectivity_m * (np.minimum(hits.reflectivities, 1.0) - USUAL_REFLECTIVITY)
        bloomed = _bloomed(true, ranges_m, hits, optics)
        step_m = self.sensor.range_step_m
        ranges_m = np.round((bloomed.ranges_m * (1.0 + self.range_scale) + bias_m) / step_m) * step_m
        outside = ~((ranges_m >= self.sensor.min_range_m) & (ranges_m <= self.sensor.max_range_m))
        ranges_m[outside] = np.nan
        intensities = np.minimum(255.0, 100.0 * bloomed.reflectivities * np.maximum(bloomed.cosines, 0.05))
        return ranges_m, np.asarray(np.round(intensities), dtype=np.float64)

    def _blurred(self, true: FloatArray, cast: Cast, optics: np.random.Generator) -> Hits:
        """Cast two beams within the divergence: between two near surfaces the echoes mix, else either is taken."""
        hits = cast(true)
        spread_rad = np.deg2rad(self.sensor.beam_deg) / 4.0
        beside = cast(_turned(true, *optics.normal(scale=spread_rad, size=(2, len(true)))))
        share = optics.random(len(true))
        with np.errstate(invalid="ignore"):
            apart_m = beside.ranges_m - hits.ranges_m
            mixed = np.abs(apart_m) < _PULSE_M
        taken = chosen(~mixed & (share > 0.5), beside, hits)
        return replace(taken, ranges_m=taken.ranges_m + np.where(mixed, share * apart_m, 0.0))

    def _returning(self, hits: Hits) -> FloatArray:
        """Return the probability (N,) that enough light comes back: it falls with the squared range."""
        closeness = (self.sensor.dark_range_m / np.maximum(hits.ranges_m, 0.1)) ** 2
        signal = _SIGNAL_AT_DARK_RANGE * hits.reflectivities / _DARK_REFLECTIVITY * hits.cosines * closeness
        return np.asarray(-np.expm1(-signal))


def draw_unit(sensor: SensorModel, rng: np.random.Generator) -> LidarUnit:
    """Draw the errors of one unit of a model."""
    accuracy, rings = sensor.accuracy, int(sensor.pattern.rings.max()) + 1
    return LidarUnit(
        sensor,
        range_bias_m=accuracy.range_m * rng.normal() + accuracy.ring_range_m * rng.normal(size=rings),
        range_scale=accuracy.range_scale * float(rng.normal()),
        glancing_m=accuracy.glancing_m * float(rng.normal()),
        reflectivity_m=accuracy.reflectivity_m * float(rng.normal()),
        elevation_rad=np.deg2rad(accuracy.ring_elevation_deg) * rng.normal(size=rings),
        azimuth_rad=np.deg2rad(accuracy.ring_azimuth_deg) * _centred(rng.normal(size=rings)),
    )


def _centred(drawn: FloatArray) -> FloatArray:
    """Take off the mean: an error of all azimuths is a rotation of the frame whose pose is the truth."""
    return np.asarray(drawn - drawn.mean())


def draw_reflectivities(lengths_m: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Draw the reflectivity of bodies with lengths (P,): a fifth is dark, a tenth of the small ones are reflectors."""
    count = len(lengths_m)
    usual, dark = rng.uniform(0.1, 0.7, size=count), rng.uniform(0.03, 0.1, size=count)
    drawn = np.where(rng.random(count) < 0.2, dark, usual)
    return np.where((lengths_m < 3.0) & (rng.random(count) < 0.1), 20.0, drawn)


def _turned(directions: FloatArray, azimuth_rad: FloatArray, elevation_rad: FloatArray) -> FloatArray:
    azimuth = np.arctan2(directions[:, 1], directions[:, 0]) + azimuth_rad
    elevation = np.arcsin(np.clip(directions[:, 2], -1.0, 1.0)) + elevation_rad
    return unit_directions(azimuth, elevation)


def _bloomed(directions: FloatArray, ranges_m: FloatArray, hits: Hits, rng: np.random.Generator) -> Hits:
    """Report the range of a retroreflector for some of the beams beside it."""
    found = replace(hits, ranges_m=ranges_m)
    bright = np.flatnonzero((hits.reflectivities > 1.0) & np.isfinite(ranges_m))
    chance = rng.random(len(directions))
    if not len(bright):
        return found
    angle_rad, nearest = cKDTree(directions[bright]).query(directions, distance_upper_bound=np.deg2rad(3 * _BLOOM_DEG))
    share = _BLOOM_SHARE * np.exp(-((angle_rad / np.deg2rad(_BLOOM_DEG)) ** 2))
    struck = (hits.reflectivities <= 1.0) & (chance < share)
    source = bright[np.minimum(nearest, len(bright) - 1)]
    faint = np.full(len(directions), USUAL_REFLECTIVITY)
    return chosen(struck, Hits(ranges_m[source], hits.cosines[source], faint), found)
