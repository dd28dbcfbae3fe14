# SPDX-License-Identifier: Apache-2.0
"""Evaluation of runs as JSON, Parquet or CSV."""

import csv
import io
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np
from pydantic import Field

from multilica.errors import UsageError
from multilica.results.document.values import Entry, Number
from multilica.runs.evaluation import Comparison, Evaluation, LeftOut, Outcome, Summary
from multilica.runs.pose_error import PoseError
from multilica.sinks.files.atomic import atomic_file

_TABLE_SUFFIXES = (".parquet", ".csv")
_TEXT_COLUMNS = frozenset({"run", "truth", "target", "lidar", "outcome", "reason"})


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
    uncertain_within: int
    uncertain_beyond: int
    success_rate: float
    rmse: ErrorEntry
    median: ErrorEntry
    largest: ErrorEntry


class ComparisonRow(Entry):
    """One LiDAR of one run; errors are null if it is neither placed nor uncertain."""

    run: str
    truth: str
    target: str
    lidar: str
    placed: bool
    uncertain: bool
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
    limits = evaluation.tolerances
    return EvaluationDocument(
        tolerances=TolerancesEntry.of(
            limits, within_deg=math.degrees(limits.within_rad), wrong_deg=math.degrees(limits.wrong_rad)
        ),
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
    errors = {f"error_{name}": value for name, value in _error(comparison.error)}
    normalised, uncertain = comparison.normalised, comparison.placement.uncertain
    placed = comparison.error is not None and not uncertain
    return ComparisonRow.of(comparison, comparison.placement, placed=placed, error_normalised=normalised, **errors)


def _summary(summary: Summary) -> SummaryEntry:
    errors = {name: _error(getattr(summary, name)) for name in ("rmse", "median", "largest")}
    return SummaryEntry.of(summary, success_rate=summary.within / summary.lidars, **errors)


def _error(error: PoseError | None) -> ErrorEntry:
    if error is None:
        return ErrorEntry()
    angles_deg = [*np.rad2deg(error.rotation_rad), math.degrees(error.angle_rad)]
    values: list[Any] = [*error.translation_m, error.distance_m, *angles_deg]
    return ErrorEntry(**dict(zip(ErrorEntry.model_fields, values, strict=True)))


def require_table_name(path: Path) -> None:
    """Check that the name ends in a known suffix.

    Raises:
        UsageError: it does not.
    """
    if path.suffix not in _TABLE_SUFFIXES:
        raise UsageError(f"Found the table name {path}; expected one that ends in {' or '.join(_TABLE_SUFFIXES)}.")


def write_table(evaluation: Evaluation, path: Path) -> None:
    """Write the rows in the format of the suffix; missing folders are created.

    Columns name their unit. Errors of a LiDAR without a pose are null, in CSV empty. Parquet has the rest of the
    evaluation document as JSON in its metadata, under the key `multilica`.

    Raises:
        UsageError: unknown suffix.
    """
    require_table_name(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as file:
        (_write_parquet if path.suffix == ".parquet" else _write_csv)(evaluation, file)


def _write_csv(evaluation: Evaluation, file: BinaryIO) -> None:
    rows = [comparison_row(comparison).model_dump() for comparison in evaluation.comparisons]
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, list(ComparisonRow.model_fields), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    file.write(text.getvalue().encode("utf-8"))


def _write_parquet(evaluation: Evaluation, file: BinaryIO) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    document = evaluation_document(evaluation)
    types = {name: _column_type(pa, name) for name in ComparisonRow.model_fields}
    schema = pa.schema(types, metadata={"multilica": document.model_dump_json(exclude={"lidars"})})
    parquet.write_table(pa.Table.from_pylist([row.model_dump() for row in document.lidars], schema=schema), file)


def _column_type(pa: Any, name: str) -> Any:  # noqa: ANN401
    if name in _TEXT_COLUMNS:
        return pa.string()
    return pa.bool_() if name in ("placed", "uncertain") else pa.float64()
