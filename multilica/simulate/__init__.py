# SPDX-License-Identifier: Apache-2.0
"""Ray-cast snapshots with exact truth."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multilica.simulate.disturbances import DISTURBANCES
    from multilica.simulate.rigs import RIGS
    from multilica.simulate.scenes import SCENES
    from multilica.simulate.simulation import Simulation, simulate_snapshot

_HOMES = {
    "DISTURBANCES": "disturbances",
    "RIGS": "rigs",
    "SCENES": "scenes",
    "Simulation": "simulation",
    "simulate_snapshot": "simulation",
}

__all__ = ["DISTURBANCES", "RIGS", "SCENES", "Simulation", "simulate_snapshot"]


def __getattr__(name: str) -> object:
    """Import a public name when it is first used: ray casting needs Open3D, the names of rigs do not."""
    if name not in _HOMES:
        raise AttributeError(f"module 'multilica.simulate' has no attribute '{name}'")
    home: object = import_module(f"multilica.simulate.{_HOMES[name]}")
    return getattr(home, name)
