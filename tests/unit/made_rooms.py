# SPDX-License-Identifier: Apache-2.0
"""Axis-aligned rooms that a spinning sensor scans, without a mesh library."""

from dataclasses import dataclass

import numpy as np

from multilica.config import PreprocessConfig
from multilica.snapshot import LidarScans, Scan
from multilica.stages.preprocess import preprocess

_NOISE_M = 0.01
_BEAM_NOISE_RAD = 3e-4


@dataclass(frozen=True)
class Face:
    """A rectangle across one axis; `gaps` is the share of beams that pass through it."""

    axis: int
    at_m: float
    lo_m: tuple
    hi_m: tuple
    gaps: float = 0.0


@dataclass(frozen=True)
class Foliage:
    """A box in which beams end at any depth."""

    lo_m: tuple
    hi_m: tuple


def box(lo_m, hi_m):
    """Its six faces."""
    return [Face(axis, bound[axis], tuple(lo_m), tuple(hi_m)) for axis in range(3) for bound in (lo_m, hi_m)]


HALL = [
    *box((-12.0, -7.0, 0.0), (12.0, 7.0, 4.0)),
    *box((4.0, 3.0, 0.0), (5.0, 4.0, 4.0)),
    *box((-7.0, -5.0, 0.0), (-5.5, -3.0, 2.0)),
    *box((6.0, -6.0, 0.0), (9.0, -5.0, 1.5)),
]
"""A hall with a pillar and two crates: no pose but the true one fits it."""

AISLE_PERIOD_M = 3.0
AISLE = [
    *box((-60.0, -3.0, 0.0), (60.0, 3.0, 3.0)),
    *(
        face
        for x_m in np.arange(-58.5, 60.0, AISLE_PERIOD_M)
        for y_m in (2.6, -3.0)
        for face in box((x_m, y_m, 0.0), (x_m + 0.6, y_m + 0.4, 3.0))
    ),
]
"""A long aisle whose pillars repeat; nothing tells which is which."""


def scan(
    name,
    T_world_sensor,
    objects,
    *,
    seed=0,
    rings=48,
    columns=480,
    range_bias_m=0.0,
    elevation_bias_rad=0.0,
    range_scale=0.0,
):
    """The preprocessed cloud of a sensor that sees 35 degrees up and down, in its own frame.

    Biases (measured minus true, the scale less one) are of all rings, or of each; the scale is of all.
    """
    rng = np.random.default_rng(seed)
    elevation, azimuth = np.meshgrid(
        np.deg2rad(np.linspace(-35, 35, rings)), np.linspace(-np.pi, np.pi, columns, endpoint=False), indexing="ij"
    )
    beams = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1)
    beams = beams.reshape(-1, 3) + rng.normal(0, _BEAM_NOISE_RAD, (beams.size // 3, 3))
    beams /= np.linalg.norm(beams, axis=1, keepdims=True)
    origin, directions = T_world_sensor.xyz_m, T_world_sensor.rotate(beams)
    ranges = np.min([_ranges(each, origin, directions, rng) for each in objects], axis=0)
    hit = np.isfinite(ranges)
    ranges = ranges * (1.0 + range_scale) + np.repeat(np.broadcast_to(range_bias_m, rings), columns)
    reported = _raised(beams, np.repeat(np.broadcast_to(elevation_bias_rad, rings), columns))
    points = reported[hit] * (ranges[hit] + rng.normal(0, _NOISE_M, hit.sum()))[:, None]
    return preprocess(LidarScans(name, (Scan(points),)), PreprocessConfig())


def _raised(beams, angle_rad):
    flat = np.hypot(beams[:, 0], beams[:, 1])
    elevation = np.arctan2(beams[:, 2], flat) + angle_rad
    return np.column_stack([beams[:, :2] * (np.cos(elevation) / flat)[:, None], np.sin(elevation)])


def _ranges(each, origin, directions, rng):
    with np.errstate(divide="ignore", invalid="ignore"):
        if isinstance(each, Foliage):
            bounds = (np.array([each.lo_m, each.hi_m])[:, None] - origin) / directions
            enters, leaves = bounds.min(axis=0).max(axis=1), bounds.max(axis=0).min(axis=1)
            ends = rng.uniform(enters, np.maximum(leaves, enters))
            return np.where((enters < leaves) & (enters > 0), ends, np.inf)
        ranges = (each.at_m - origin[each.axis]) / directions[:, each.axis]
        hits = origin + directions * ranges[:, None]
        others = [axis for axis in range(3) if axis != each.axis]
        inside = np.all((hits[:, others] >= np.take(each.lo_m, others)), axis=1)
        inside &= np.all((hits[:, others] <= np.take(each.hi_m, others)), axis=1)
    solid = rng.random(len(ranges)) >= each.gaps
    return np.where(inside & solid & (ranges > 0), ranges, np.inf)
