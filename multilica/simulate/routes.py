# SPDX-License-Identifier: Apache-2.0
"""Routes of a vehicle from stop to stop."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from multilica.errors import UnknownNameError, UsageError
from multilica.geometry import RigidTransform
from multilica.simulate.rigs import Rig
from multilica.simulate.scenes import Scene
from multilica.simulate.scenes.roads import EXIT_BEND_RAD, EXIT_LEG_M

Place = tuple[float, float, float]
"""x, y (m) and yaw (rad) of the vehicle in the world frame."""
_LEG_M = 6.0
_SMALLEST_RADIUS_M = 5.0
_SWEEP = 7


@dataclass(frozen=True, slots=True)
class Leg:
    """An arc of constant curvature from one stop to the next: its length, negative backwards, and its turn."""

    length_m: float
    turn_rad: float

    def end(self, start: Place, share: float = 1.0) -> Place:
        """Return where the vehicle is after a share of the way."""
        x_m, y_m, yaw_rad = start
        turned_rad = share * self.turn_rad
        # The chord of the arc points half as far round.
        chord_m, towards_rad = share * self.length_m * np.sinc(turned_rad / 2.0 / np.pi), yaw_rad + turned_rad / 2.0
        along = float(np.cos(towards_rad)), float(np.sin(towards_rad))
        return x_m + float(chord_m) * along[0], y_m + float(chord_m) * along[1], yaw_rad + turned_rad


def _straight(count: int, rng: np.random.Generator) -> list[Leg]:
    return [Leg(_LEG_M * rng.uniform(0.9, 1.1), rng.normal(scale=0.01)) for _ in range(count)]


def _turning(count: int, rng: np.random.Generator) -> list[Leg]:
    """Turn in several moves, forwards and backwards, as in a narrow street."""
    shares = rng.uniform(0.8, 1.2, size=count)
    turns_rad = float(rng.choice([-1.0, 1.0])) * np.pi * shares / shares.sum()
    lengths_m = np.maximum(_LEG_M, _SMALLEST_RADIUS_M * np.abs(turns_rad)) * rng.uniform(1.0, 1.2, size=count)
    return [Leg(m * (-1.0) ** k, rad) for k, (m, rad) in enumerate(zip(lengths_m, turns_rad, strict=True))]


def _exit(count: int, rng: np.random.Generator) -> list[Leg]:
    shares = rng.uniform(0.8, 1.1, size=count).tolist()
    return [Leg(share * EXIT_LEG_M, share * EXIT_BEND_RAD) for share in shares]


def _yard(count: int, rng: np.random.Generator) -> list[Leg]:
    side = float(rng.choice([-1.0, 1.0]))
    turns_rad = side * np.deg2rad(rng.uniform(30.0, 80.0, size=count))
    return [Leg(max(rng.uniform(4.0, 8.0), _SMALLEST_RADIUS_M * abs(turn)), turn) for turn in turns_rad.tolist()]


ROUTES: Mapping[str, Callable[[int, np.random.Generator], list[Leg]]] = {
    "straight": _straight,
    "turning": _turning,
    "exit": _exit,
    "yard": _yard,
}
"""Legs between the stops, by name: straight on, 6 m each; a half turn in all; a bend to the right; round a yard."""
PASSABLE_ROUTES = ("straight", "exit")
"""Routes on which traffic can pass."""


def plan_legs(route: str, stops: int, rng: np.random.Generator, step_m: float | None) -> list[Leg]:
    """Plan the legs between the stops.

    Args:
        step_m: length of each leg; None: as usual on the route.

    Raises:
        UnknownNameError: no such route.
        UsageError: no stop, or legs without a length.
    """
    if route not in ROUTES:
        raise UnknownNameError("route", route, ROUTES)
    if stops < 1 or (step_m is not None and step_m <= 0.0):
        raise UsageError(f"A drive needs a stop or more, some way apart; found {stops} stops and a way of {step_m} m.")
    legs = ROUTES[route](stops - 1, rng)
    return legs if step_m is None else [replace(leg, length_m=np.copysign(step_m, leg.length_m)) for leg in legs]


def places_of(scene: Scene, legs: Sequence[Leg]) -> list[Place]:
    """Return the places of the stops; the first is where the scene has the vehicle stand."""
    places = [(*scene.vehicle_xy_m, scene.vehicle_yaw_rad)]
    for leg in legs:
        places.append(leg.end(places[-1]))
    return places


def standing_at(scene: Scene, place: Place) -> Scene:
    """Return the scene with the vehicle at another place."""
    return replace(scene, vehicle_xy_m=place[:2], vehicle_yaw_rad=place[2])


def pose_at(scene: Scene, place: Place) -> RigidTransform:
    """Return ``T_world_base`` at a place."""
    return scene.terrain.standing_pose(*place)


def sweep(places: Sequence[Place], legs: Sequence[Leg]) -> list[Place]:
    """Return places along the whole way."""
    between = zip(pairwise(places), legs, strict=True)
    return [
        places[0],
        *(leg.end(start, share / _SWEEP) for (start, _), leg in between for share in range(1, _SWEEP + 1)),
    ]


def with_room_along(scene: Scene, rig: Rig, way: Sequence[Place]) -> Scene:
    """Leave out each body that the vehicle would drive into.

    Raises:
        UsageError: a wall, a fence or the ground is in the way.
    """
    cleared = scene
    for place in way:
        cleared = standing_at(cleared, place).with_room_for(*rig.room_m)
    return standing_at(cleared, way[0])
