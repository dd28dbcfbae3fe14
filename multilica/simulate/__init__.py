# SPDX-License-Identifier: Apache-2.0
"""Simulated snapshots with exact ground truth."""

from multilica.simulate.disturbances import DISTURBANCES
from multilica.simulate.rigs import RIGS
from multilica.simulate.scenes import SCENES
from multilica.simulate.simulation import Simulation, simulate_snapshot

__all__ = ["DISTURBANCES", "RIGS", "SCENES", "Simulation", "simulate_snapshot"]
