# SPDX-License-Identifier: Apache-2.0
"""Map of the stops of a drive, seen from above."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from multilica.geometry import FloatArray, RigidTransform
from multilica.results.document import ResultDocument, StopEntry

SIZE_PX = (640, 360)
_MARGIN_PX = 50.0
_ARROW_PX = 26.0
_LEAST_SPAN_M = 2.0


class MappedStop(NamedTuple):
    """A stop on the map with the tip of an arrow along the x axis of the target LiDAR, in pixels."""

    name: str
    x: float
    y: float
    tip_x: float
    tip_y: float


class MappedLinks(NamedTuple):
    """Links between two stops, as ends on the map; `used` tells how many of them count."""

    ends: tuple[MappedStop, MappedStop]
    used: int
    refused: int


class DriveMap(NamedTuple):
    """The stops that links connect.

    Args:
        metres: length of the scale bar; scale_px: its length in pixels.
    """

    stops: Sequence[MappedStop]
    links: Sequence[MappedLinks]
    metres: float
    scale_px: float


def drive_maps(document: ResultDocument, level: RigidTransform) -> list[DriveMap]:
    """Return a map per group of linked stops.

    Args:
        level: pose of the target in a frame with z up.
    """
    firsts = dict.fromkeys(stop.first for stop in document.stops)
    return [
        _map([stop for stop in document.stops if stop.first == first], document, level.rotation) for first in firsts
    ]


def links_of(document: ResultDocument) -> Counter[str]:
    """Count the links of each stop that the poses rest on."""
    return Counter(name for link in document.links if link.used for name in sorted(link.stops))


def _map(stops: Sequence[StopEntry], document: ResultDocument, rotation: FloatArray) -> DriveMap:
    matrices = np.array([stop.T_first_stop for stop in stops])
    places_m = (matrices[:, :3, 3] @ rotation.T)[:, :2]
    ahead = (matrices[:, :3, 0] @ rotation.T)[:, :2]
    low_m, high_m = places_m.min(axis=0), places_m.max(axis=0)
    span_m = np.maximum(high_m - low_m, _LEAST_SPAN_M)
    px_per_m = float(np.min((np.array(SIZE_PX) - 2.0 * _MARGIN_PX) / span_m))
    centred = (places_m - (low_m + high_m) / 2.0) * px_per_m * (1.0, -1.0) + np.array(SIZE_PX) / 2.0
    tips = centred + _ARROW_PX * ahead * (1.0, -1.0)
    shown = {
        stop.name: MappedStop(stop.name, *np.round(place, 1).tolist(), *np.round(tip, 1).tolist())
        for stop, place, tip in zip(stops, centred, tips, strict=True)
    }
    counts = Counter((tuple(sorted(link.stops)), link.used) for link in document.links)
    links = [
        MappedLinks((shown[one], shown[other]), counts[(one, other), True], counts[(one, other), False])
        for one, other in sorted({key for key, _ in counts})
        if {one, other} <= {*shown}
    ]
    metres = 10.0 ** np.floor(np.log10(max(span_m)))
    return DriveMap([*shown.values()], links, float(metres), round(float(metres) * px_per_m, 1))
