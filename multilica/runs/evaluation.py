# SPDX-License-Identifier: Apache-2.0
"""Comparison of runs with ground truth, also as JSON, Parquet and CSV."""

import csv
import io
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Literal, get_args

import numpy as np
from pydantic import Field, InstanceOf

from multilica.errors import InputError, UsageError
from multilica.extrinsics import Extrinsics
from multilica.results import LidarPlacement
from multilica.results.values import Entry, Number
from multilica.runs.pose_error import PoseError, as_sigma, normalised_error
from multilica.runs.run_documents import SavedRun
from multilica.sinks.files.atomic import atomic_file

Outcome = Literal["within", "between", "false_accept", "false_refuse", "uncertain_within", "uncertain_beyond"]
OUTCOMES: tuple[Outcome, ...] = get_args(Outcome)

UNCERTAIN_SIGMA = 3.0
"""An uncertain pose that is off by more of its own sigma (`as_sigma`) is `uncertain_beyond`."""


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Limits of a right and of a wrong placement.

    Args:
        within_m, within_deg: a placed LiDAR off by no more than both is a success.
        wrong_m, wrong_deg: a placed LiDAR off by more than either is a false accept.
        wrong_sigma: so is one that is off by more sigma of its own covariance (`as_sigma`).

    Raises:
        UsageError: a limit is not above zero, or `within` is above `wrong`.
    """

    within_m: float = 0.02
    within_deg: float = 0.1
    wrong_m: float = 0.05
    wrong_deg: float = 0.5
    wrong_sigma: float = 4.0

    def __post_init__(self) -> None:
        for unit, within, wrong in (("m", self.within_m, self.wrong_m), ("deg", self.within_deg, self.wrong_deg)):
            if not 0.0 < within <= wrong < math.inf:
                raise UsageError(
                    f"Found 'within' {within:g} {unit} and 'wrong' {wrong:g} {unit}; "
                    "expected limits above zero, 'within' not above 'wrong'."
                )
        if not 0.0 < self.wrong_sigma < math.inf:
            raise UsageError(f"Found 'wrong' {self.wrong_sigma:g} sigma; expected limits above zero.")

    def outcome(self, error: PoseError | None, normalised: float | None = None, *, uncertain: bool = False) -> Outcome:
        """Return the outcome for an error; None stands for a LiDAR that was not placed.

        Args:
            normalised: its `normalised_error`; None if the run has no covariance.
            uncertain: whether the run calls the pose uncertain, so that only its own sigma counts.
        """
        if error is None:
            return "false_refuse"
        if uncertain:
            right = normalised is not None and as_sigma(normalised) <= UNCERTAIN_SIGMA
            return "uncertain_within" if right else "uncertain_beyond"
        if error.distance_m > self.wrong_m or error.angle_deg > self.wrong_deg:
            return "false_accept"
        if normalised is not None and as_sigma(normalised) > self.wrong_sigma:
            return "false_accept"
        right = error.distance_m <= self.within_m and error.angle_deg <= self.within_deg
        return "within" if right else "between"


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The true poses of the LiDARs in any common frame, with the name of their file."""

    name: str
    extrinsics: Extrinsics

    def __contains__(self, lidar: str) -> bool:
        return lidar in self.extrinsics.members


class Comparison(Entry):
    """One LiDAR of one run compared with the truth; errors are null if it is neither placed nor uncertain.

    `error_normalised` is the `normalised_error`, `error_sigma` the same as the deviation of one normal variable; both
    are null if the run has no covariance.
    """

    run: str
    truth: str
    target: str
    lidar: str
    placed: bool
    uncertain: bool
    outcome: Outcome
    error_x_m: Number = None
    error_y_m: Number = None
    error_z_m: Number = None
    error_distance_m: Number = None
    error_roll_deg: Number = None
    error_pitch_deg: Number = None
    error_yaw_deg: Number = None
    error_angle_deg: Number = None
    error_normalised: Number = None
    error_sigma: Number = None
    fitness: Number = None
    reason: str
    error: InstanceOf[PoseError] | None = Field(None, exclude=True)


class LeftOut(Entry):
    """A LiDAR, or a whole run if `lidar` is None, that no count includes."""

    run: str
    lidar: str | None
    reason: str


class ErrorFigures(Entry):
    """Errors along and about the axes of the run's target; null if no LiDAR was placed."""

    x_m: Number = None
    y_m: Number = None
    z_m: Number = None
    distance_m: Number = None
    roll_deg: Number = None
    pitch_deg: Number = None
    yaw_deg: Number = None
    angle_deg: Number = None


class Summary(Entry):
    """Counts of outcomes, with statistics of the absolute errors of all placed LiDARs."""

    lidars: int
    within: int
    between: int
    false_accept: int
    false_refuse: int
    uncertain_within: int
    uncertain_beyond: int
    success_rate: float
    rmse: ErrorFigures
    median: ErrorFigures
    largest: ErrorFigures


class Runs(Entry):
    """The evaluated runs; `faultless` counts those with every compared LiDAR within the limits."""

    given: tuple[str, ...]
    compared: int
    faultless: int


class Evaluation(Entry):
    """All runs compared with the truth, in the given order, per LiDAR in name order; targets are not compared.

    This is the output of `multilica evaluate --json`; null stands for what is not known.
    """

    schema_: Literal["multilica/evaluation/1"] = Field("multilica/evaluation/1", alias="schema")
    tolerances: Tolerances
    runs: Runs
    overall: Summary
    by_lidar: Mapping[str, Summary]
    lidars: tuple[Comparison, ...]
    left_out: tuple[LeftOut, ...]


def evaluate(runs: Sequence[SavedRun], truths: Sequence[Truth], tolerances: Tolerances | None = None) -> Evaluation:
    """Compare runs with one truth for all, or with one truth each in the same order.

    Raises:
        UsageError: wrong number of truths, or a run given twice.
        InputError: no LiDAR of any run could be compared.
    """
    tolerances = tolerances or Tolerances()
    names = [run.name for run in runs]
    repeated = [name for name, count in Counter(names).items() if count > 1]
    if repeated:
        raise UsageError(f"Run {repeated[0]} is given more than once; give each run once, or it counts twice.")
    found: list[Comparison] = []
    left_out: list[LeftOut] = []
    for run, truth in zip(runs, truth_per_run(truths, len(runs)), strict=True):
        left_out += _left_out(run, truth)
        common = [one for one in run.placements if {one.lidar, run.target} <= truth.extrinsics.members]
        found += [_comparison(run, truth, one, tolerances) for one in common if one.lidar != run.target]
    if not found:
        why = f": {left_out[0].reason}" if left_out else ""
        raise InputError(f"No LiDAR of {', '.join(names) or 'no run'} can be compared with the truth{why}.")
    compared, faulty = {one.run for one in found}, {one.run for one in found if one.outcome != "within"}
    lidars = sorted({one.lidar for one in found})
    return Evaluation(
        tolerances=tolerances,
        runs=Runs(given=tuple(names), compared=len(compared), faultless=len(compared - faulty)),
        overall=_summary(found),
        by_lidar={lidar: _summary([one for one in found if one.lidar == lidar]) for lidar in lidars},
        lidars=tuple(found),
        left_out=tuple(left_out),
    )


def _summary(compared: Sequence[Comparison]) -> Summary:
    counts = Counter(one.outcome for one in compared)
    errors = [one.error for one in compared if one.error is not None and not one.uncertain]
    statistics = {
        "rmse": PoseError.statistic(errors, lambda rows: np.sqrt(np.mean(rows**2, axis=0))),
        "median": PoseError.statistic(errors, lambda rows: np.median(rows, axis=0)),
        "largest": PoseError.statistic(errors, lambda rows: np.max(rows, axis=0)),
    }
    return Summary(
        lidars=len(compared),
        **{outcome: counts[outcome] for outcome in OUTCOMES},
        success_rate=counts["within"] / len(compared),
        **{name: ErrorFigures(**({} if each is None else each.figures)) for name, each in statistics.items()},
    )


def truth_per_run(truths: Sequence[Truth], runs: int) -> Sequence[Truth]:
    """Return one truth per run, from one for all or from one each.

    Raises:
        UsageError: another number of truths.
    """
    if len(truths) == 1:
        return [truths[0]] * runs
    if len(truths) != runs:
        raise UsageError(
            f"Found {len(truths)} truths for {runs} run{'s' * (runs != 1)}; "
            "expected one truth for all runs, or one per run in the same order."
        )
    return truths


def _left_out(run: SavedRun, truth: Truth) -> list[LeftOut]:
    if run.target not in truth:
        return [LeftOut(run=run.name, lidar=None, reason=f"{truth.name} does not have its target '{run.target}'")]
    seen = {placement.lidar for placement in run.placements}
    reasons = {name: f"{truth.name} does not have it" for name in sorted(seen) if name not in truth}
    reasons |= dict.fromkeys(
        sorted({*truth.extrinsics.T_target_source} - seen), f"{truth.name} has it, the run does not"
    )
    return [LeftOut(run=run.name, lidar=name, reason=reason) for name, reason in reasons.items()]


def _comparison(run: SavedRun, truth: Truth, found: LidarPlacement, tolerances: Tolerances) -> Comparison:
    error, normalised = None, None
    if found.T_target_source is not None:
        true_pose = truth.extrinsics.between(run.target, found.lidar)
        error = PoseError.between(found.T_target_source, true_pose)
        if found.covariance is not None:
            normalised = normalised_error(found.T_target_source, true_pose, found.covariance)
    return Comparison(
        run=run.name,
        truth=truth.name,
        target=run.target,
        lidar=found.lidar,
        placed=error is not None and not found.uncertain,
        uncertain=found.uncertain,
        outcome=tolerances.outcome(error, normalised, uncertain=found.uncertain),
        **({} if error is None else {f"error_{name}": value for name, value in error.figures.items()}),
        error_normalised=normalised,
        error_sigma=None if normalised is None else as_sigma(normalised),
        fitness=found.fitness,
        reason=found.reason,
        error=error,
    )


_TABLE_SUFFIXES = (".parquet", ".csv")
_COLUMNS = [name for name, field in Comparison.model_fields.items() if not field.exclude]
_TEXT_COLUMNS = ("run", "truth", "target", "lidar", "outcome", "reason")


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
    evaluation as JSON in its metadata, under the key `multilica`.

    Raises:
        UsageError: unknown suffix.
    """
    require_table_name(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as file:
        (_write_parquet if path.suffix == ".parquet" else _write_csv)(evaluation, file)


def _write_csv(evaluation: Evaluation, file: BinaryIO) -> None:
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, _COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(row.model_dump() for row in evaluation.lidars)
    file.write(text.getvalue().encode("utf-8"))


def _write_parquet(evaluation: Evaluation, file: BinaryIO) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    kinds = dict.fromkeys(_TEXT_COLUMNS, pa.string()) | dict.fromkeys(("placed", "uncertain"), pa.bool_())
    types = {name: kinds.get(name, pa.float64()) for name in _COLUMNS}
    schema = pa.schema(types, metadata={"multilica": evaluation.model_dump_json(exclude={"lidars"})})
    parquet.write_table(pa.Table.from_pylist([row.model_dump() for row in evaluation.lidars], schema=schema), file)
