# SPDX-License-Identifier: Apache-2.0
"""Simulated vehicles with their LiDARs, by name."""

from multilica.simulate.rigs.catalogue import RIGS, fan
from multilica.simulate.rigs.rig import BASE, Mount, Rig, as_built, misjudged

__all__ = ["BASE", "RIGS", "Mount", "Rig", "as_built", "fan", "misjudged"]
