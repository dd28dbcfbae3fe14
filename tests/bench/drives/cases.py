# SPDX-License-Identifier: Apache-2.0
"""Drives by row of the table."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

_ROUTES = {"yard": "yard", "motorway_exit": "exit"}


@dataclass(frozen=True, slots=True)
class Row:
    """Drives that the table shows together.

    Args:
        places: scenes with the route through each.
        parked: cars that leave or come between the stops.
        knock: one LiDAR moves by 2 cm between stops 2 and 3.
        logged: with the frames on the way, for the odometry of the LiDARs, ours and the peer's.
    """

    name: str
    rigs: tuple[str, ...]
    places: tuple[tuple[str, str], ...]
    stops: tuple[int, ...] = (4,)
    parked: int = 0
    knock: bool = False
    logged: bool = False


@dataclass(frozen=True, slots=True)
class DriveCase:
    """One drive."""

    row: Row
    rig: str
    scene: str
    route: str
    stops: int
    seed: int

    def __str__(self) -> str:
        return f"{self.rig} {self.scene} {self.route} {self.stops} {self.seed}"


def drives_of(row: Row, count: int, first_seed: int) -> Iterator[DriveCase]:
    """Return the first drives of a row, which go round its rigs, places and numbers of stops."""
    return islice(_all(row, first_seed), count)


def _all(row: Row, first_seed: int) -> Iterator[DriveCase]:
    number = 0
    while True:
        for scene, route in row.places:
            for rig in row.rigs:
                stops = row.stops[number % len(row.stops)]
                yield DriveCase(row, rig, scene, route, stops, first_seed + number)
                number += 1


_TURN = (("street", "turning"), ("town", "turning"), ("parking", "turning"), ("yard", "yard"), ("garage", "turning"))
TURNING = (
    Row("front and back, turning", ("front_back",), _TURN, (3, 4)),
    Row("four corners of 70 x 25, turning", ("corners",), _TURN, (3, 4)),
    Row("truck with trailer, turning", ("trailer",), (("yard", "yard"), ("parking", "yard")), (3, 4)),
)
STRAIGHT = (
    Row(
        "no common view, straight on",
        ("front_back", "corners", "trailer"),
        (("street", "straight"), ("town", "straight"), ("motorway", "straight")),
        logged=True,
    ),
)
NARROW = (
    Row(
        "narrow rigs",
        ("narrow4", "chain"),
        (("street", "turning"), ("town", "straight"), ("parking", "turning"), ("street", "straight")),
    ),
    Row("sides in the field", ("sides",), (("open_field", "turning"), ("open_field", "straight"))),
    Row("motorways", ("narrow4", "chain", "sides"), (("motorway", "straight"), ("motorway_exit", "exit"))),
)
BESIDE_HAND_EYE = (
    Row(
        "with the frames on the way",
        ("front_back", "corners", "narrow4", "edgar", "sides", "chain", "trailer"),
        (("street", "turning"), ("yard", "yard")),
        logged=True,
    ),
)
LOOK_ALIKE = (
    Row(
        "places that look alike",
        ("front_back", "corners", "edgar"),
        (
            ("equal_houses", "straight"),
            ("symmetric_garage", "turning"),
            ("court", "turning"),
            ("avenue", "straight"),
            ("tunnel_niches", "straight"),
            ("car_park", "turning"),
        ),
    ),
)
PARKED = (
    Row(
        "parked cars that leave or come",
        ("front_back", "corners", "narrow4"),
        (("parking", "turning"), ("street", "turning"), ("yard", "yard"), ("car_park", "turning")),
        parked=6,
    ),
)
KNOCK = (
    Row(
        "a knock by 2 cm after stop 2",
        ("edgar", "corners", "narrow4", "sides"),
        (("street", "turning"), ("parking", "turning"), ("town", "turning")),
        knock=True,
    ),
)
