# SPDX-License-Identifier: Apache-2.0
"""Calibrating a simulated scene and setting the outcome against its truth."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from multilica.config import CalibrationConfig
from multilica.pipeline import calibrate
from multilica.results import CalibrationResult
from multilica.simulate import Simulation, simulate_snapshot

GOOD_M, GOOD_DEG = 0.02, 0.1
WRONG_M, WRONG_DEG = 0.05, 0.5


@dataclass(frozen=True, slots=True)
class Outcome:
    """One LiDAR other than the target."""

    rig: str
    scene: str
    seed: int
    lidar: str
    placed: bool
    reason: str
    error_m: float
    error_deg: float

    @property
    def good(self) -> bool:
        """Within 2 cm and 0.1 degree."""
        return self.placed and self.error_m <= GOOD_M and self.error_deg <= GOOD_DEG

    @property
    def wrong(self) -> bool:
        """Placed more than 5 cm or 0.5 degree off."""
        return self.placed and (self.error_m > WRONG_M or self.error_deg > WRONG_DEG)


def outcomes(simulation: Simulation, result: CalibrationResult, key: tuple[str, str, int]) -> list[Outcome]:
    """The errors of every LiDAR against the truth."""
    found = []
    for placement in result.placements:
        if placement.lidar == result.target:
            continue
        error_m, error_rad = float("nan"), float("nan")
        if placement.T_target_source is not None:
            truth = simulation.truth.between(result.target, placement.lidar)
            error_m, error_rad = placement.T_target_source.distance_to(truth)
        found.append(
            Outcome(*key, placement.lidar, placement.placed, placement.reason, error_m, float(np.rad2deg(error_rad)))
        )
    return found


def run_case(
    rig: str, scene: str, seed: int, configs: Iterable[CalibrationConfig]
) -> list[tuple[list[Outcome], CalibrationResult, float]]:
    """Simulate once, calibrate with each configuration; with the seconds that each took."""
    simulation = simulate_snapshot(rig, scene, seed)
    runs = []
    for config in configs:
        start = time.perf_counter()
        result = calibrate(simulation.snapshot, config)
        runs.append((outcomes(simulation, result, (rig, scene, seed)), result, time.perf_counter() - start))
    return runs
