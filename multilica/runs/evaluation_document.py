# SPDX-License-Identifier: Apache-2.0
"""Evaluation of runs as JSON and as rows of a table."""

import math
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic import Field

from multilica.results.document.values import Entry, Number
from multilica.runs.evaluation import Comparison, Evaluation, LeftOut, Outcome, Summary, Tolerances
from multilica.runs.pose_error import PoseError

__all__ = ["ComparisonRow", "EvaluationDocument", "comparison_row", "evaluation_document"]


class ErrorEntry(Entry):
    """Errors along and about the axes of the run's target; null if no LiDAR was placed."""

    x_m: Number = None
    y_m: Number = None
    z_m: Number = None
    distance_m: Number = None
    roll_deg: Number = None
    pitch_deg: Number = None
    yaw_deg: Number = None
    angle_deg: Number = None


class TolerancesEntry(Entry):
    """Limits of the outcomes, see `Tolerances`."""

    within_m: float
    within_deg: float
    wrong_m: float
    wrong_deg: float
    wrong_sigma: float


class RunsEntry(Entry):
    """The evaluated runs; `faultless` are those of which every compared LiDAR is within the limits."""

    given: tuple[str, ...]
    compared: int
    faultless: int


class SummaryEntry(Entry):
    """Counts of outcomes, with statistics of the absolute errors of all placed LiDARs."""

    lidars: int
    within: int
    between: int
    false_accept: int
    false_refuse: int
    success_rate: float
    rmse: ErrorEntry
    median: ErrorEntry
    largest: ErrorEntry


class ComparisonRow(Entry):
    """One LiDAR of one run; errors are null if it was not placed."""

    run: str
    truth: str
    target: str
    lidar: str
    placed: bool
    outcome: Outcome
    error_x_m: Number
    error_y_m: Number
    error_z_m: Number
    error_distance_m: Number
    error_roll_deg: Number
    error_pitch_deg: Number
    error_yaw_deg: Number
    error_angle_deg: Number
    error_normalised: Number
    error_sigma: Number
    fitness: Number
    reason: str


class EvaluationDocument(Entry):
    """The output of `multilica evaluate --json`; null stands for what is not known."""

    schema_: Literal["multilica/evaluation/1"] = Field("multilica/evaluation/1", alias="schema")
    tolerances: TolerancesEntry
    runs: RunsEntry
    overall: SummaryEntry
    by_lidar: Mapping[str, SummaryEntry]
    lidars: tuple[ComparisonRow, ...]
    left_out: tuple[LeftOut, ...]


def evaluation_document(evaluation: Evaluation) -> EvaluationDocument:
    """Convert an evaluation to its JSON document."""
    return EvaluationDocument(
        tolerances=_tolerances(evaluation.tolerances),
        runs=RunsEntry(
            given=evaluation.runs,
            compared=len(evaluation.compared_runs),
            faultless=len(evaluation.faultless_runs),
        ),
        overall=_summary(evaluation.overall),
        by_lidar={lidar: _summary(summary) for lidar, summary in evaluation.by_lidar.items()},
        lidars=tuple(map(comparison_row, evaluation.comparisons)),
        left_out=evaluation.left_out,
    )


def comparison_row(comparison: Comparison) -> ComparisonRow:
    """Convert one LiDAR of one run to a flat row."""
    placement, error = comparison.placement, _error(comparison.error)
    return ComparisonRow(
        run=comparison.run,
        truth=comparison.truth,
        target=comparison.target,
        lidar=placement.lidar,
        placed=comparison.error is not None,
        outcome=comparison.outcome,
        **{f"error_{name}": value for name, value in error},
        error_normalised=comparison.normalised,
        error_sigma=comparison.error_sigma,
        fitness=placement.fitness,
        reason=placement.reason,
    )


def _tolerances(tolerances: Tolerances) -> TolerancesEntry:
    return TolerancesEntry(
        within_m=tolerances.within_m,
        within_deg=math.degrees(tolerances.within_rad),
        wrong_m=tolerances.wrong_m,
        wrong_deg=math.degrees(tolerances.wrong_rad),
        wrong_sigma=tolerances.wrong_sigma,
    )


def _summary(summary: Summary) -> SummaryEntry:
    return SummaryEntry(
        lidars=summary.lidars,
        within=summary.within,
        between=summary.between,
        false_accept=summary.false_accept,
        false_refuse=summary.false_refuse,
        success_rate=summary.within / summary.lidars,
        rmse=_error(summary.rmse),
        median=_error(summary.median),
        largest=_error(summary.largest),
    )


def _error(error: PoseError | None) -> ErrorEntry:
    if error is None:
        return ErrorEntry()
    angles_deg = [*np.rad2deg(error.rotation_rad), math.degrees(error.angle_rad)]
    values: list[Any] = [*error.translation_m, error.distance_m, *angles_deg]
    return ErrorEntry(**dict(zip(ErrorEntry.model_fields, values, strict=True)))
