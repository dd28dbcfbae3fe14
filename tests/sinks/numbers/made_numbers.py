# SPDX-License-Identifier: Apache-2.0
"""Events of a made-up run in which no two numbers are alike, so that none can stand for another unseen.

The run is that of `made_events("uncertain")` with figures of its own: the constants, in the units of their names.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from multilica import events
from multilica.geometry import RigidTransform
from multilica.results import (
    CalibrationResult,
    GroundPlane,
    LidarPlacement,
    MergeCandidate,
    PairRegistration,
    PairResidual,
    Refinement,
    SnapshotDeviation,
    SnapshotReport,
    Spread,
)
from tests.sinks.made_events import made_events

FRONT, REAR, TOP = "front left/1", "rear", "top"

POSE_FITNESS = {FRONT: 0.731, REAR: 0.612}
POSE_RMSE_MM = {FRONT: 62.4, REAR: 41.7}
SIGMA_MM = {FRONT: (9.1, 4.3, 2.7), REAR: (3.4, 12.6, 31.8)}
SIGMA_DEG = {FRONT: (0.011, 0.137, 0.023), REAR: (0.151, 0.031, 0.083)}
SPREAD_MM = {FRONT: (1.2, 7.5, 5.6), REAR: (8.8, 2.1, 6.7)}
SPREAD_DEG = {FRONT: (0.061, 0.042, 0.073), REAR: (0.017, 0.094, 0.025)}
SNAPSHOTS = {FRONT: 5, REAR: 4}
PRIOR_SHIFT_MM = {FRONT: 21.5, REAR: 137.0}
PRIOR_TURN_DEG = {FRONT: 1.75, REAR: 3.25}

GROUND_HEIGHT_M = 2.345
GROUND_RPY_DEG = (1.75, -3.25, 0.0)
GROUND_SHARE = 0.37
GROUND_AREA_M2, GROUND_RESIDUAL_MM, GROUND_SIGMA_MM, GROUND_SIGMA_DEG = 187.0, 7.4, 2.9, (0.061, 0.033)

# By target and source as they are registered.
PAIR_FITNESS = {(REAR, FRONT): 0.523, (FRONT, TOP): 0.687, (REAR, TOP): 0.741}
PAIR_RMSE_MM = {(REAR, FRONT): 71.3, (FRONT, TOP): 58.6, (REAR, TOP): 34.9}
PAIR_COUNTS = {(REAR, FRONT): (1510, 26, 73, 9), (FRONT, TOP): (932, 14, 57, 8), (REAR, TOP): (681, 3, 41, 7)}
"""Points that agree, violate, are occluded and unseen."""

MERGE_FITNESS = {FRONT: 0.655, REAR: 0.577}
MERGE_RMSE_MM = {FRONT: 66.1, REAR: 77.2}

RESIDUALS = {(TOP, FRONT): (5.4, 0.0321, 2.2, 0.0173, 0.94), (TOP, REAR): (15.8, 0.0119, 8.3, 0.0062, 0.31)}
"""By target and source: mm and degrees before, mm and degrees after, weight."""
APART = 2.5
"""Times as far are pairs from where the others put them."""

DEVIATIONS = {"dawn": {FRONT: (3.1, 0.213), REAR: (12.3, 0.045)}, "dusk": {FRONT: (6.6, 0.087), REAR: (4.9, 0.178)}}
"""By snapshot and LiDAR: mm and degrees."""

SECONDS = {"features": 1.25, "fine": 3.5}

_CORRELATION = 0.3 ** np.abs(np.subtract.outer(np.arange(6), np.arange(6)))


def numbered_events() -> Iterator[events.Event]:
    for event in made_events("uncertain"):
        changes: dict[str, Any] = {}
        match event:
            case (
                events.PairRegistered(registration=found)
                | events.VerdictChanged(registration=found)
                | events.GroupsRegistered(registration=found)
                | events.LoopRegistered(registration=found)
            ):
                changes = {"registration": _pair(found)}
            case events.MergeStepTaken(decision=decision):
                candidates = tuple(map(_candidate, decision.candidates))
                chosen = decision.chosen and _candidate(decision.chosen)
                changes = {"decision": replace(decision, candidates=candidates, chosen=chosen)}
            case events.RigRefined():
                changes = {"refinement": refinement()}
            case events.GroundEstimated():
                changes = {"ground": ground()}
            case events.CalibrationFinished(result=result):
                changes = {"result": _result(result)}
        yield replace(event, **changes)


def covariance_of(lidar: str) -> np.ndarray:
    sigmas = np.concatenate([np.radians(SIGMA_DEG[lidar]), np.array(SIGMA_MM[lidar]) / 1000.0])
    return np.outer(sigmas, sigmas) * _CORRELATION


def refinement() -> Refinement:
    return Refinement.of(
        tuple(
            PairResidual(
                *pair,
                before_mm / 1000.0,
                before_deg,
                after_mm / 1000.0,
                after_deg,
                weight,
                1e-6 if weight < 0.5 else 0.4,
                APART * after_mm / 1000.0,
                APART * after_deg,
            )
            for pair, (before_mm, before_deg, after_mm, after_deg, weight) in RESIDUALS.items()
        )
    )


def ground_sentence() -> str:
    roll_deg, pitch_deg, _ = GROUND_RPY_DEG
    return (
        f"round, frame base: {TOP} is {GROUND_HEIGHT_M:.3f} m above it, with roll {roll_deg:.2f} deg "
        f"and pitch {pitch_deg:.2f} deg. Sigma is {GROUND_SIGMA_MM:.1f} mm and {max(GROUND_SIGMA_DEG):.3f} deg. "
        f"{GROUND_AREA_M2:.0f} m2 are seen, {GROUND_RESIDUAL_MM:.1f} mm from smooth"
    )


def ground() -> GroundPlane:
    base = RigidTransform.from_xyz_rpy("base", TOP, (0.0, 0.0, GROUND_HEIGHT_M), np.radians(GROUND_RPY_DEG))
    sigma_deg = np.array(GROUND_SIGMA_DEG)
    figures = (GROUND_SHARE, GROUND_AREA_M2, GROUND_RESIDUAL_MM / 1000.0, GROUND_SIGMA_MM / 1000.0, sigma_deg)
    return GroundPlane(base.matrix[2, :3], GROUND_HEIGHT_M, base, *figures)


def _result(result: CalibrationResult) -> CalibrationResult:
    return replace(
        result,
        placements=tuple(map(_placement, result.placements)),
        pairs=tuple(map(_pair, result.pairs)),
        ground=ground(),
        refinement=refinement(),
        snapshots=tuple(_snapshot(name) for name in DEVIATIONS),
        timing_s=SECONDS,
    )


def _placement(place: LidarPlacement) -> LidarPlacement:
    name = place.lidar
    if name == TOP:
        return place
    turn = RigidTransform.from_xyz_rpy(TOP, TOP, (0.0, 0.0, 0.0), (0.0, np.radians(PRIOR_TURN_DEG[name]), 0.0))
    prior = (turn @ place.T_target_source).matrix.copy()
    prior[:3, 3] = place.T_target_source.xyz_m
    prior[1, 3] += PRIOR_SHIFT_MM[name] / 1000.0
    return replace(
        place,
        fitness=POSE_FITNESS[name],
        rmse_m=POSE_RMSE_MM[name] / 1000.0,
        covariance=covariance_of(name),
        T_target_source_prior=RigidTransform(TOP, name, prior),
        spread=Spread(SNAPSHOTS[name], tuple(mm / 1000.0 for mm in SPREAD_MM[name]), SPREAD_DEG[name]),
    )


def _pair(found: PairRegistration) -> PairRegistration:
    key = (found.target, found.source)
    if key not in PAIR_FITNESS:
        return found
    agree, violate, occluded, unseen = PAIR_COUNTS[key]
    best, *others = found.registrations
    score = replace(best.visibility, agree=agree, violate=violate, occluded=occluded, unseen=unseen)
    figures = {"fitness": PAIR_FITNESS[key], "rmse_m": PAIR_RMSE_MM[key] / 1000.0}
    return replace(found, **figures, registrations=(replace(best, visibility=score, **figures), *others))


def _candidate(one: MergeCandidate) -> MergeCandidate:
    return replace(one, fitness=MERGE_FITNESS[one.source], rmse_m=MERGE_RMSE_MM[one.source] / 1000.0)


def _snapshot(name: str) -> SnapshotReport:
    deviations = (SnapshotDeviation(lidar, mm / 1000.0, deg) for lidar, (mm, deg) in DEVIATIONS[name].items())
    return SnapshotReport(name, f"{name}.mcap", "", deviations=tuple(deviations))
