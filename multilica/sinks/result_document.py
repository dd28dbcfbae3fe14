# SPDX-License-Identifier: Apache-2.0
"""A calibration's outcome as plain values that every JSON reader takes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from multilica.config import CalibrationConfig
from multilica.geometry import RigidTransform
from multilica.results import (
    Assessment,
    CalibrationResult,
    GroundPlane,
    LidarPlacement,
    MergeCandidate,
    MergeDecision,
    PairRegistration,
    Reason,
    Refinement,
    SensorHealth,
    SnapshotReport,
    Spread,
)
from multilica.sinks.prior_words import surprise
from multilica.sinks.provenance import Provenance

__all__ = ["RESULT_SCHEMA", "json_safe", "result_document"]

RESULT_SCHEMA = "multilica/result/1"

_AS_THEY_ARE = (str, int, bool, type(None))


def result_document(result: CalibrationResult, config: CalibrationConfig, provenance: Provenance) -> dict[str, Any]:
    """What `result.json` holds.

    Lengths are in metres, angles in degrees (extrinsic xyz), poses map points of the source to the target. Whatever
    is not known is null; NaN and infinity do not occur.
    """
    document = {
        "schema": RESULT_SCHEMA,
        "status": result.status,
        "target": result.target,
        "target_reason": result.target_reason,
        "refusal": None if result.refusal is None else asdict(result.refusal),
        "lidars": {entry.lidar: _placement(entry, health, result.target) for entry, health in _lidars(result)},
        "pairs": [_pair(pair) for pair in result.pairs],
        "decisions": [_decision(decision) for decision in result.decisions],
        "snapshots": [_snapshot(snapshot) for snapshot in result.snapshots],
        "refinement": None if result.refinement is None else _refinement(result.refinement),
        "ground": None if result.ground is None else _ground(result.ground),
        "timing_s": dict(result.timing_s),
        "input": provenance.input,
        "config": config.model_dump(mode="json"),
        "versions": provenance.versions,
        "platform": provenance.platform,
    }
    return {key: json_safe(value) for key, value in document.items()}


def json_safe(value: object) -> object:
    """The value with arrays as lists, tuples as lists, and null for every float that JSON has no word for."""
    if type(value) in _AS_THEY_ARE:
        return value
    if isinstance(value, dict | Mapping):
        return {str(key): json_safe(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return json_safe(value.tolist())
    if isinstance(value, list | tuple):
        return [json_safe(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _lidars(result: CalibrationResult) -> Iterable[tuple[LidarPlacement, SensorHealth | None]]:
    health = {each.lidar: each for each in result.health}
    return ((placement, health.get(placement.lidar)) for placement in result.placements)


def _placement(placement: LidarPlacement, health: SensorHealth | None, target: str) -> dict[str, Any]:
    return {
        "placed": placement.placed,
        **_pose(placement.T_target_source),
        "fitness": placement.fitness,
        "rmse_m": placement.rmse_m,
        "sigma_xyz_m": placement.sigma_xyz_m,
        "sigma_rotation_deg": placement.sigma_rotation_deg,
        "sigma_from": placement.sigma_from,
        "covariance": placement.covariance,
        "prior": _prior(placement, target),
        "spread": None if placement.spread is None else _spread(placement.spread),
        "reason": placement.reason,
        "health": None if health is None else _health(health),
    }


def _health(health: SensorHealth) -> dict[str, Any]:
    return {
        "returns": health.returns,
        "near_share": health.near_share,
        "soiled_share": health.soiled_share,
        "reasons": [_reason(reason) for reason in health.reasons],
    }


def _prior(placement: LidarPlacement, target: str) -> dict[str, Any] | None:
    if placement.T_target_source_prior is None:
        return None
    off_m, off_rad = placement.prior_deviation or (math.nan, math.nan)
    return {
        **_pose(placement.T_target_source_prior),
        "deviation_m": off_m,
        "deviation_deg": math.degrees(off_rad),
        "surprise": surprise(placement, target),
    }


def _spread(spread: Spread) -> dict[str, Any]:
    return {"snapshots": spread.snapshots, "xyz_m": spread.xyz_m, "rotation_deg": spread.rotation_deg}


def _snapshot(snapshot: SnapshotReport) -> dict[str, Any]:
    return {
        "name": snapshot.name,
        "source": snapshot.source,
        "sha256": snapshot.source_sha256,
        "refusal": snapshot.refusal or None,
        "outliers": [deviation.lidar for deviation in snapshot.outliers],
        "disputed": snapshot.disputed,
        "deviations": [asdict(deviation) for deviation in snapshot.deviations],
    }


def _refinement(refinement: Refinement) -> dict[str, Any]:
    before_m, after_m = refinement.cycle_error_m
    before_deg, after_deg = refinement.cycle_error_deg
    return {
        "cycle_error_before": {"m": before_m, "deg": before_deg},
        "cycle_error_after": {"m": after_m, "deg": after_deg},
        "pairs": [asdict(edge) for edge in refinement.edges],
    }


def _pose(T_target_source: RigidTransform | None) -> dict[str, Any]:
    if T_target_source is None:
        return dict.fromkeys(("T_target_source", "xyz_m", "rpy_deg", "quaternion_xyzw"))
    return {
        "T_target_source": T_target_source.matrix,
        "xyz_m": T_target_source.xyz_m,
        "rpy_deg": T_target_source.rpy_deg,
        "quaternion_xyzw": T_target_source.quaternion_xyzw,
    }


def _pair(pair: PairRegistration) -> dict[str, Any]:
    return {
        "target": pair.target,
        "source": pair.source,
        **_pose(pair.T_target_source),
        "fitness": pair.fitness,
        "rmse_m": pair.rmse_m,
        "inliers": pair.inliers,
        "converged": pair.converged,
        "iterations": pair.iterations,
        "engine": pair.engine,
        "hypothesis": pair.hypothesis,
        "hessian": pair.hessian,
        "verdict": {"outcome": pair.verdict.outcome, "reasons": [_reason(reason) for reason in pair.verdict.reasons]},
        "assessments": [_assessment(assessment) for assessment in pair.assessments],
    }


def _reason(reason: Reason) -> dict[str, Any]:
    return {"code": reason.code, "value": reason.value, "limit": reason.limit, "text": reason.text}


def _assessment(assessment: Assessment) -> dict[str, Any]:
    beams = assessment.testimony
    return {
        "hypothesis": assessment.hypothesis,
        "origin": assessment.origin,
        "T_target_source": assessment.T_target_source.matrix,
        "agree": beams.agree,
        "violate": beams.violate,
        "occluded": beams.occluded,
        "unseen": beams.unseen,
        "evidence": beams.evidence,
        "fitness": assessment.fitness,
        "rmse_m": assessment.rmse_m,
        "weakest_curvature": assessment.weakest_curvature,
        "held_by": beams.held_by,
        "hold": None if assessment.hold is None else asdict(assessment.hold),
    }


def _decision(decision: MergeDecision) -> dict[str, Any]:
    return {
        "step": decision.step,
        "candidates": [_candidate(candidate) for candidate in decision.candidates],
        "chosen": None if decision.chosen is None else _candidate(decision.chosen),
        "reason": decision.reason,
        "groups": decision.groups,
    }


def _candidate(candidate: MergeCandidate) -> dict[str, Any]:
    return {
        "target": candidate.target,
        "source": candidate.source,
        "fitness": candidate.fitness,
        "rmse_m": candidate.rmse_m,
        "passes": candidate.passes,
        "evidence": candidate.evidence,
        "reason": candidate.reason,
    }


def _ground(ground: GroundPlane) -> dict[str, Any]:
    base_pose = ground.T_base_target
    return {
        "normal": ground.normal,
        "offset_m": ground.offset_m,
        "T_base_target": base_pose.matrix,
        "xyz_m": base_pose.xyz_m,
        "rpy_deg": base_pose.rpy_deg,
        "inlier_share": ground.inlier_share,
    }
