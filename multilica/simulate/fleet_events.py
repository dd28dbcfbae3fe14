# SPDX-License-Identifier: Apache-2.0
"""Known events of the vehicles of a simulated fleet: LiDARs that jump, creep or die."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from multilica.geometry import FloatArray, RigidTransform

EventKind = Literal["jump", "creep", "dead"]

_SIDE = 3
"""Logs on each side of a jump: fewer do not tell a motion from an outlier."""
LEAST_LOGS: dict[EventKind, int] = {"jump": 2 * _SIDE, "creep": 2, "dead": 2}
"""Logs that a vehicle needs for an event."""
_JUMP_M, _JUMP_DEG = (0.03, 0.08), (0.3, 1.0)
_CREEP_M, _CREEP_DEG = (0.002, 0.004), (0.01, 0.03)
_CREEP_PERIOD_NS = 30 * 86_400 * 10**9


@dataclass(frozen=True, slots=True)
class PlannedEvent:
    """An event of one LiDAR.

    Args:
        first_log: index, among the vehicle's logs by time, of the first one after it.
        time_ns: when it happens; a creep goes on from there.
        shift_m: (3,) along the axes of the LiDAR as built; of a creep, within 30 days.
        turn_rad: (3,) axis times angle about the same axes; of a creep, within 30 days.
    """

    vehicle: str
    lidar: str
    kind: EventKind
    first_log: int
    time_ns: int
    shift_m: tuple[float, ...] = (0.0, 0.0, 0.0)
    turn_rad: tuple[float, ...] = (0.0, 0.0, 0.0)

    def moved(self, time_ns: int) -> RigidTransform | None:
        """Return the LiDAR's pose in its own frame as built at a time; None if it has not moved."""
        if self.kind == "dead" or time_ns < self.time_ns:
            return None
        share = (time_ns - self.time_ns) / _CREEP_PERIOD_NS if self.kind == "creep" else 1.0
        rotation = Rotation.from_rotvec(share * np.asarray(self.turn_rad)).as_matrix()
        shift_m = share * np.asarray(self.shift_m)
        return RigidTransform.from_rotation_translation(self.lidar, self.lidar, rotation, shift_m)

    def decisive(self, logs: int) -> frozenset[int]:
        """Return the indices, of so many logs of the vehicle, without which the event could not be dated."""
        if self.kind == "creep":
            return frozenset((0, logs - 1))
        return frozenset(range(max(0, self.first_log - _SIDE), min(logs, self.first_log + _SIDE)))


def draw_event(
    kind: EventKind, vehicle: str, lidars: Sequence[str], times_ns: Sequence[int], rng: np.random.Generator
) -> PlannedEvent:
    """Draw an event of a vehicle with logs at these times, at least `LEAST_LOGS` of them.

    A jump of 3 to 8 cm and 0.3 to 1 degree lies between two logs; a creep of 2 to 4 mm and 0.01 to 0.03 degrees within
    30 days begins with the first log; a dead LiDAR returns nothing from some log on.
    """
    lidar = lidars[int(rng.integers(len(lidars)))]
    if kind == "creep":
        shift_m, turn_rad = _of_length(rng, *_CREEP_M), _of_length(rng, *np.deg2rad(_CREEP_DEG))
        return PlannedEvent(vehicle, lidar, kind, 0, times_ns[0], tuple(shift_m), tuple(turn_rad))
    side = min(_SIDE, len(times_ns) // 2)
    first = int(rng.integers(side, len(times_ns) - side + 1))
    time_ns = (times_ns[first - 1] + times_ns[first]) // 2
    if kind == "dead":
        return PlannedEvent(vehicle, lidar, kind, first, time_ns)
    shift_m, turn_rad = _of_length(rng, *_JUMP_M), _of_length(rng, *np.deg2rad(_JUMP_DEG))
    return PlannedEvent(vehicle, lidar, kind, first, time_ns, tuple(shift_m), tuple(turn_rad))


def _of_length(rng: np.random.Generator, least: float, most: float) -> list[float]:
    """Return a vector (3,) of random direction with a length between two limits."""
    direction: FloatArray = rng.normal(size=3)
    return list((rng.uniform(least, most) * direction / np.linalg.norm(direction)).tolist())
