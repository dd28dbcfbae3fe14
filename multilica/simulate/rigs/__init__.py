# SPDX-License-Identifier: Apache-2.0
"""Simulated vehicles with their LiDARs, by name."""

from collections.abc import Mapping

from multilica.simulate.rigs.cars import BLIND, EDGAR, HELIPR, SIDES, fan
from multilica.simulate.rigs.rig import BASE, Mount, Rig, as_built, misjudged
from multilica.simulate.rigs.rings import RING6, SECTORS8, SECTORS20
from multilica.simulate.rigs.truck import TRUCK

__all__ = ["BASE", "RIGS", "Mount", "Rig", "as_built", "fan", "misjudged"]

RIGS: Mapping[str, Rig] = {
    rig.name: rig for rig in (BLIND, fan(overlap_deg=22.5), EDGAR, HELIPR, RING6, SECTORS8, SECTORS20, SIDES, TRUCK)
}
