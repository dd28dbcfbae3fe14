# SPDX-License-Identifier: Apache-2.0
"""Ranges spoilt between the surface and the report."""

from __future__ import annotations

import numpy as np

from multilica.geometry import FloatArray
from multilica.simulate.sensors import SensorModel

__all__ = ["RAIN_SHARE", "blocked_beams", "soiled", "with_rain"]

RAIN_SHARE = 0.02
_DIRT_ECHO_SHARE = 0.3
_DIRT_ECHO_M = (0.3, 0.95)


def with_rain(sensor: SensorModel, ranges_m: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Some returns (nan: none) replaced by drops at any nearer range."""
    struck = np.isfinite(ranges_m) & (rng.random(len(ranges_m)) < RAIN_SHARE)
    way = rng.random(len(ranges_m))
    drops_m = sensor.min_range_m + way * (ranges_m - sensor.min_range_m)
    return np.where(struck, drops_m, ranges_m)


def blocked_beams(directions: FloatArray, axis: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """The half of the beams (N, 3) that lean most towards the axis (3,): one connected patch of the window."""
    lean = directions @ axis
    return np.asarray(lean > np.median(lean))


def soiled(directions: FloatArray, ranges_m: FloatArray, axis: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Ranges with half of the beams blocked: most give nothing, the rest an echo below one metre."""
    blocked = blocked_beams(directions, axis)
    echo = rng.random(len(ranges_m)) < _DIRT_ECHO_SHARE
    dirt_m = np.where(echo, rng.uniform(*_DIRT_ECHO_M, size=len(ranges_m)), np.nan)
    return np.where(blocked, dirt_m, ranges_m)
