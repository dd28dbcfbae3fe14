# SPDX-License-Identifier: Apache-2.0
"""An evaluation as plain values that every JSON reader takes."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from multilica.fleet.evaluation import OUTCOMES, Comparison, Evaluation, Summary, Tolerances
from multilica.fleet.pose_error import PoseError

__all__ = ["EVALUATION_SCHEMA", "comparison_row", "evaluation_document"]

EVALUATION_SCHEMA = "multilica/evaluation/1"
_COMPONENTS = ("x_m", "y_m", "z_m", "distance_m", "roll_deg", "pitch_deg", "yaw_deg", "angle_deg")


def evaluation_document(evaluation: Evaluation) -> dict[str, Any]:
    """What `multilica evaluate --json` prints.

    Lengths are in metres, angles in degrees; whatever is not known is null.
    """
    return {
        "schema": EVALUATION_SCHEMA,
        "tolerances": _tolerances(evaluation.tolerances),
        "runs": {
            "given": list(evaluation.runs),
            "compared": len(evaluation.compared_runs),
            "faultless": len(evaluation.faultless_runs),
        },
        "overall": _summary(evaluation.overall),
        "by_lidar": {lidar: _summary(summary) for lidar, summary in evaluation.by_lidar.items()},
        "lidars": [comparison_row(comparison) for comparison in evaluation.comparisons],
        "left_out": [asdict(left_out) for left_out in evaluation.left_out],
    }


def comparison_row(comparison: Comparison) -> dict[str, Any]:
    """One LiDAR of one run as a flat row; the errors of one that was not placed are None."""
    placement = comparison.placement
    return {
        "run": comparison.run,
        "truth": comparison.truth,
        "target": comparison.target,
        "lidar": placement.lidar,
        "placed": comparison.error is not None,
        "outcome": comparison.outcome,
        **{f"error_{name}": value for name, value in _components(comparison.error).items()},
        "error_normalised": comparison.normalised,
        "error_sigma": comparison.error_sigma,
        "fitness": placement.fitness,
        "reason": placement.reason,
    }


def _tolerances(tolerances: Tolerances) -> dict[str, float]:
    return {
        "within_m": tolerances.within_m,
        "within_deg": math.degrees(tolerances.within_rad),
        "wrong_m": tolerances.wrong_m,
        "wrong_deg": math.degrees(tolerances.wrong_rad),
        "wrong_sigma": tolerances.wrong_sigma,
    }


def _summary(summary: Summary) -> dict[str, Any]:
    counts: dict[str, int] = {outcome: getattr(summary, outcome) for outcome in OUTCOMES}
    return {
        "lidars": summary.lidars,
        **counts,
        "success_rate": summary.within / summary.lidars,
        "rmse": _components(summary.rmse),
        "median": _components(summary.median),
        "largest": _components(summary.largest),
    }


def _components(error: PoseError | None) -> dict[str, float | None]:
    if error is None:
        return dict.fromkeys(_COMPONENTS)
    roll_pitch_yaw_deg = np.rad2deg(error.rotation_rad).tolist()
    translation_m = error.translation_m.tolist()
    values = (*translation_m, error.distance_m, *roll_pitch_yaw_deg, math.degrees(error.angle_rad))
    return dict(zip(_COMPONENTS, values, strict=True))
