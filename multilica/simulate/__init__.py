# SPDX-License-Identifier: Apache-2.0
"""Simulated snapshots with exact ground truth."""

from multilica.simulate.disturbances import DISTURBANCES
from multilica.simulate.fleet import FleetPlan, PlannedLog, plan_fleet
from multilica.simulate.rigs import RIGS
from multilica.simulate.scenes import SCENES
from multilica.simulate.simulation import Simulation, simulate_snapshot, thinned, true_extrinsics

__all__ = [
    "DISTURBANCES",
    "RIGS",
    "SCENES",
    "FleetPlan",
    "PlannedLog",
    "Simulation",
    "plan_fleet",
    "simulate_snapshot",
    "thinned",
    "true_extrinsics",
]
