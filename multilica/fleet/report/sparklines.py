# SPDX-License-Identifier: Apache-2.0
"""Small lines of a vehicle's LiDARs: distance to their median pose, log by log."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from multilica.fleet.report.contents import LidarHistory, PageVehicle
from multilica.fleet.report.plots import number
from multilica.fleet.report.time_axis import TimeAxis
from multilica.geometry import FloatArray

WIDTH_PX, HEIGHT_PX = 76, 26
_MARGIN_PX = 2.5
_TALLEST = 8.0
"""Times the median vehicle: taller ones are cut off, so that one wrong pose does not flatten the others."""


@dataclass(frozen=True, slots=True)
class VehicleSparkline:
    """Lines of a vehicle.

    Args:
        largest, lidar: the largest value, and whose it is.
        paths: per LiDAR its path data and whether it is the one with the largest value, which comes last.
    """

    largest: float
    lidar: str
    paths: tuple[tuple[str, bool], ...]


@dataclass(frozen=True, slots=True)
class Sparklines:
    """Lines of the vehicles by name, all with one scale from zero to `top`."""

    top: float
    vehicles: Mapping[str, VehicleSparkline]


def sparklines(vehicles: Sequence[PageVehicle], values: Callable[[LidarHistory], FloatArray]) -> Sparklines:
    """Draw the values (N,) of each history of each vehicle."""
    drawn = {vehicle.name: [each for each in vehicle.histories if len(each.time_ns)] for vehicle in vehicles}
    largest = {name: max(float(values(each).max()) for each in own) for name, own in drawn.items() if own}
    if not largest:
        return Sparklines(0.0, {})
    top = min(max(largest.values()), _TALLEST * float(np.median(list(largest.values())))) or 1.0
    return Sparklines(top, {name: _lines(drawn[name], values, top) for name in largest})


def _lines(
    histories: Sequence[LidarHistory], values: Callable[[LidarHistory], FloatArray], top: float
) -> VehicleSparkline:
    times_ns = np.concatenate([each.time_ns for each in histories])
    axis = TimeAxis.around(times_ns, 0.0, WIDTH_PX)
    ordered = sorted(histories, key=lambda each: float(values(each).max()))
    paths = tuple((_path(each, values(each), axis, top), each is ordered[-1]) for each in ordered)
    return VehicleSparkline(float(values(ordered[-1]).max()), ordered[-1].lidar, paths)


def _path(history: LidarHistory, values: FloatArray, axis: TimeAxis, top: float) -> str:
    rows = HEIGHT_PX - _MARGIN_PX - (HEIGHT_PX - 2 * _MARGIN_PX) * np.minimum(values / top, 1.0)
    places = zip(axis.place(history.time_ns), rows, strict=True)
    return "M" + " ".join(f"{number(x)} {number(y)}" for x, y in places) + ("h0" if len(rows) == 1 else "")
