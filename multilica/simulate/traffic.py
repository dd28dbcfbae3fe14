# SPDX-License-Identifier: Apache-2.0
"""Cars that drive past, each at another place in the scan of each LiDAR."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from multilica.errors import UsageError
from multilica.simulate.scenes import Scene
from multilica.simulate.shapes.mesh import Mesh, merged
from multilica.simulate.shapes.objects import random_car

LONGEST_DELAY_S = 0.06
"""By which a LiDAR scans after another: a car at 25 m/s goes 1.5 m on."""
_REACH_M = 80.0
# No car starts within the reach and drives this far within a second.
_FARTHEST_M = 120.0
# From the middle of the lane in which the vehicle stands, which stays free.
_OWN_LANE_M = 1.8


@dataclass(frozen=True, slots=True)
class Flow:
    """A kind of traffic: speeds of lanes, and distances from a car's middle to the next, as ranges."""

    both_ways: bool
    speed_m_s: tuple[float, float]
    distance_m: tuple[float, float]


FLOWS: Mapping[str, Flow] = {
    "one_way": Flow(both_ways=False, speed_m_s=(15.0, 25.0), distance_m=(15.0, 40.0)),
    "both_ways": Flow(both_ways=True, speed_m_s=(15.0, 25.0), distance_m=(15.0, 40.0)),
    "queue": Flow(both_ways=False, speed_m_s=(1.0, 4.0), distance_m=(7.0, 10.0)),
}


@dataclass(frozen=True, slots=True, eq=False)
class MovingCar:
    """A car that drives along a lane, at `x_m` when the first LiDAR starts its first scan."""

    body: Mesh
    x_m: float
    lane_y_m: float
    velocity_m_s: float


def random_traffic(scene: Scene, flow: Flow, rng: np.random.Generator, lasting_s: float = 0.0) -> tuple[MovingCar, ...]:
    """Place cars on the lanes beside the vehicle; one way is that of the vehicle if such a lane is free.

    Further cars follow within the time that the traffic lasts.

    Raises:
        UsageError: the scene has no lanes.
    """
    if not scene.lanes:
        raise UsageError("Traffic needs a scene with lanes, such as motorway or bridge; this one has none.")
    free = [lane for lane in scene.lanes if abs(lane[0] - scene.vehicle_xy_m[1]) > _OWN_LANE_M]
    used = free if flow.both_ways else [lane for lane in free if lane[1] > 0.0] or free
    cars = []
    for y_m, sense in used:
        speed_m_s = rng.uniform(*flow.speed_m_s)
        behind_m, ahead_m = (speed_m_s * lasting_s if sense == way else 0.0 for way in (1.0, -1.0))
        x_m = -_REACH_M - behind_m + rng.uniform(0.0, flow.distance_m[1])
        while x_m < _REACH_M + ahead_m:
            cars.append(MovingCar(random_car(rng), x_m, y_m + rng.normal(scale=0.1), sense * speed_m_s))
            x_m += rng.uniform(*flow.distance_m)
    return tuple(cars)


def traffic(scene: Scene, cars: Iterable[MovingCar], time_s: float) -> Mesh:
    """Build the cars in the world frame that are near at a time after the first scan."""
    places_m = [(car, car.x_m + car.velocity_m_s * time_s) for car in cars]
    near = [(car, x_m) for car, x_m in places_m if abs(x_m) < _FARTHEST_M]
    return merged(scene.terrain.place(car.body, x_m, car.lane_y_m) for car, x_m in near)
