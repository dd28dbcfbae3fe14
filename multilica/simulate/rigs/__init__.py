# SPDX-License-Identifier: Apache-2.0
"""Simulated vehicles with their LiDARs, by name."""

from multilica.simulate.rigs.catalogue import RIGS, chain_rig
from multilica.simulate.rigs.rig import BASE, Mount, Rig, as_built, with_drawing_error

__all__ = ["BASE", "RIGS", "Mount", "Rig", "as_built", "chain_rig", "with_drawing_error"]
