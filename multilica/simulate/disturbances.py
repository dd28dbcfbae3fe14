# SPDX-License-Identifier: Apache-2.0
"""Disturbances of a snapshot, by name."""

from collections.abc import Collection, Mapping
from types import MappingProxyType

import numpy as np

from multilica.errors import UnknownNameError, UsageError
from multilica.geometry import FloatArray
from multilica.simulate.sensors import SensorModel

__all__ = ["DISTURBANCES", "add_dirt", "add_rain", "blocked_beams", "require_known"]

DISTURBANCES: Mapping[str, str] = MappingProxyType(
    {
        "dead:<lidar>": "that LiDAR returns nothing",
        "dirty:<lidar>": "a connected half of that LiDAR's beams is blocked at its window",
        "low_overlap": "rig chain only: neighbours share about one tenth of their field of view",
        "moving": "the vehicle drives on at 3 m/s",
        "pedestrians": "people walk around the vehicle",
        "rain": "2 % of the returns are strays at random nearer ranges",
        "truck": "a truck beside the vehicle blocks about half of one LiDAR's view",
    }
)
_RAIN_SHARE = 0.02
_DIRT_ECHO_SHARE = 0.3
_DIRT_ECHO_M = (0.3, 0.95)


def require_known(disturbances: Collection[str], rig: str, lidars: Collection[str]) -> None:
    """Check that a rig with these LiDARs can have these disturbances.

    Raises:
        UnknownNameError: no such disturbance, or no such LiDAR.
        UsageError: the rig cannot have this disturbance.
    """
    for text in disturbances:
        kind, _, lidar = text.partition(":")
        if kind in ("dead", "dirty"):
            if lidar not in lidars:
                raise UnknownNameError("LiDAR", lidar, lidars, f"rig '{rig}' for disturbance '{text}'")
        elif text not in DISTURBANCES:
            raise UnknownNameError("disturbance", text, DISTURBANCES)
    if "low_overlap" in disturbances and rig != "chain":
        raise UsageError(f"Disturbance 'low_overlap' exists only for rig 'chain', not for rig '{rig}'; leave it out.")


def add_rain(sensor: SensorModel, ranges_m: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Replace some returns by drops at random nearer ranges."""
    struck = np.isfinite(ranges_m) & (rng.random(len(ranges_m)) < _RAIN_SHARE)
    drops_m = sensor.min_range_m + rng.random(len(ranges_m)) * (ranges_m - sensor.min_range_m)
    return np.where(struck, drops_m, ranges_m)


def add_dirt(directions: FloatArray, ranges_m: FloatArray, axis: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Block half of the beams: most of these return nothing, the others an echo below one metre."""
    echo = rng.random(len(ranges_m)) < _DIRT_ECHO_SHARE
    dirt_m = np.where(echo, rng.uniform(*_DIRT_ECHO_M, size=len(ranges_m)), np.nan)
    return np.where(blocked_beams(directions, axis), dirt_m, ranges_m)


def blocked_beams(directions: FloatArray, axis: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return a mask of the half of the beams (N, 3) closest to the axis (3,): one connected patch of the window."""
    lean = directions @ axis
    return np.asarray(lean > np.median(lean))
