# SPDX-License-Identifier: Apache-2.0
"""What can go wrong while a snapshot is taken, by name."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from multilica.errors import UnknownNameError, UsageError

__all__ = ["DISTURBANCES", "Disturbances", "parse_disturbances"]

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
_PER_LIDAR = ("dead", "dirty")
_ONLY_CHAIN = "low_overlap"


@dataclass(frozen=True, slots=True)
class Disturbances:
    """The disturbances of one simulation.

    Args:
        general: names of those that concern the whole snapshot.
        dead, dirty: names of LiDARs.
    """

    general: frozenset[str] = frozenset()
    dead: frozenset[str] = frozenset()
    dirty: frozenset[str] = frozenset()


def parse_disturbances(texts: Iterable[str], rig: str, lidars: Collection[str]) -> Disturbances:
    """Read names as `DISTURBANCES` lists them.

    Args:
        rig: the rig that they are meant for.
        lidars: names of its LiDARs.

    Raises:
        UnknownNameError: no such disturbance, or no such LiDAR.
        UsageError: the rig cannot have this disturbance.
    """
    found: dict[str, set[str]] = {"general": set(), **{kind: set() for kind in _PER_LIDAR}}
    for text in texts:
        kind, _, lidar = text.partition(":")
        if kind in _PER_LIDAR:
            if lidar not in lidars:
                raise UnknownNameError("LiDAR", lidar, lidars, f"rig '{rig}', of which disturbance '{text}' speaks")
            found[kind].add(lidar)
        elif text in DISTURBANCES:
            found["general"].add(text)
        else:
            raise UnknownNameError("disturbance", text, DISTURBANCES)
    if _ONLY_CHAIN in found["general"] and rig != "chain":
        raise UsageError(
            f"Disturbance '{_ONLY_CHAIN}' was given with rig '{rig}', but only rig 'chain' has it; leave it out."
        )
    return Disturbances(*(frozenset(found[kind]) for kind in ("general", *_PER_LIDAR)))
