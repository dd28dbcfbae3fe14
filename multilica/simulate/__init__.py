# SPDX-License-Identifier: Apache-2.0
"""Simulated snapshots and drives with exact ground truth."""

from multilica.simulate.disturbances import DISTURBANCES
from multilica.simulate.drives import FIRST_STOP, SimulatedDrive, simulate_drive
from multilica.simulate.fleet import FleetPlan, PlannedLog, plan_fleet
from multilica.simulate.rigs import RIGS
from multilica.simulate.routes import ROUTES
from multilica.simulate.scenes import SCENES
from multilica.simulate.simulation import Simulation, simulate_snapshot, thinned, true_extrinsics

__all__ = [
    "DISTURBANCES",
    "FIRST_STOP",
    "RIGS",
    "ROUTES",
    "SCENES",
    "FleetPlan",
    "PlannedLog",
    "SimulatedDrive",
    "Simulation",
    "plan_fleet",
    "simulate_drive",
    "simulate_snapshot",
    "thinned",
    "true_extrinsics",
]
