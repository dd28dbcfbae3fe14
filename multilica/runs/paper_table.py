# SPDX-License-Identifier: Apache-2.0
"""The evaluation of the paper: errors per axis over scenes and LiDARs.

Definitions of Kulmer et al. 2024, section "Evaluation Metrics"; where its text leaves a choice, those of the evaluation
scripts that the authors publish with their code.
"""

import math
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Literal

import numpy as np
from pydantic import Field, InstanceOf

from multilica.geometry import RigidTransform
from multilica.results import LidarPlacement
from multilica.results.values import Entry, Number
from multilica.runs.evaluation import LeftOut, Tolerances, Truth, evaluate, truth_per_run
from multilica.runs.pose_error import PoseError
from multilica.runs.run_documents import SavedRun


class AxisFigures(Entry):
    """Errors along the target's axes and about the source's; null if nothing was placed."""

    x_m: Number = None
    y_m: Number = None
    z_m: Number = None
    roll_deg: Number = None
    pitch_deg: Number = None
    yaw_deg: Number = None
    angle_deg: Number = None


class PaperRow(AxisFigures):
    """One LiDAR relative to another in one run; a success if both are placed and the error is within the limits."""

    run: str
    target: str
    source: str
    success: bool
    error: InstanceOf[PoseError] | None = Field(None, exclude=True)


class PaperSummary(Entry):
    """Figures over scenes; `lidar` is null for pairs, `pair` for LiDARs, both for all.

    `rmse` covers the placed LiDARs, wrong ones included.
    """

    lidar: str | None = None
    pair: tuple[str, str] | None = None
    poses: int
    placed: int
    successes: int
    placed_rate: Number
    success_rate: Number
    rmse: AxisFigures

    @property
    def name(self) -> str:
        """The LiDAR, or the pair, for people; ``all`` over all of them."""
        return f"{self.pair[1]} in {self.pair[0]}" if self.pair else self.lidar or "all"


class PaperTable(Entry):
    """The paper's table of a set of runs, the output of `multilica evaluate --table paper --json`.

    `rows` are of every compared LiDAR of every run, relative to the run's target; `between_rows` of every two compared
    LiDARs, names in order, the target among them. Null stands for what is not known.
    """

    schema_: Literal["multilica/paper-table/1"] = Field("multilica/paper-table/1", alias="schema")
    within_m: float
    within_deg: float
    to_target: PaperSummary
    by_lidar: tuple[PaperSummary, ...]
    between: PaperSummary
    by_pair: tuple[PaperSummary, ...]
    rows: tuple[PaperRow, ...]
    between_rows: tuple[PaperRow, ...]
    left_out: tuple[LeftOut, ...]


def paper_table(runs: Sequence[SavedRun], truths: Sequence[Truth], tolerances: Tolerances | None = None) -> PaperTable:
    """Compute the paper's table of runs, with one truth for all or one each in the same order.

    Raises:
        UsageError: wrong number of truths, or a run given twice.
        InputError: no LiDAR of any run could be compared.
    """
    evaluation = evaluate(runs, truths, tolerances)
    limits = evaluation.tolerances
    to_target: list[PaperRow] = []
    between: list[PaperRow] = []
    for run, truth in zip(runs, truth_per_run(truths, len(runs)), strict=True):
        if run.target not in truth:
            continue
        known = sorted((one for one in run.placements if one.lidar in truth), key=lambda one: one.lidar)
        target = next((one for one in known if one.lidar == run.target), LidarPlacement(run.target, ""))
        to_target += [_row(run, truth, target, one, limits) for one in known if one.lidar != run.target]
        between += [_row(run, truth, *pair, limits) for pair in combinations(known, 2)]
    lidars = sorted({one.source for one in to_target})
    pairs = sorted({(one.target, one.source) for one in between})
    return PaperTable(
        within_m=limits.within_m,
        within_deg=limits.within_deg,
        to_target=summarise(to_target),
        by_lidar=tuple(summarise((one for one in to_target if one.source == name), lidar=name) for name in lidars),
        between=summarise(between),
        by_pair=tuple(
            summarise((one for one in between if (one.target, one.source) == pair), pair=pair) for pair in pairs
        ),
        rows=tuple(to_target),
        between_rows=tuple(between),
        left_out=evaluation.left_out,
    )


def summarise(rows: Iterable[PaperRow], **names: object) -> PaperSummary:
    """Return counts and root mean squares of errors; `names` are those of the summary."""
    rows = list(rows)
    errors = [one.error for one in rows if one.error is not None]
    successes = sum(one.success for one in rows)
    rmse = PoseError.statistic(errors, lambda each: np.sqrt(np.mean(each**2, axis=0)))
    return PaperSummary.of(
        poses=len(rows),
        placed=len(errors),
        successes=successes,
        placed_rate=len(errors) / len(rows) if rows else math.nan,
        success_rate=successes / len(rows) if rows else math.nan,
        rmse=AxisFigures(**_figures(rmse)),
        **names,
    )


def _figures(error: PoseError | None) -> dict[str, float]:
    return {} if error is None else {name: error.figures[name] for name in AxisFigures.model_fields}


def _row(run: SavedRun, truth: Truth, target: LidarPlacement, source: LidarPlacement, limits: Tolerances) -> PaperRow:
    poses = [_placed_pose(run, one) for one in (target, source)]
    error = None
    if poses[0] is not None and poses[1] is not None:
        true = truth.extrinsics.between(target.lidar, source.lidar)
        error = PoseError.between(poses[0].inverse() @ poses[1], true, about="source")
    success = error is not None and error.distance_m <= limits.within_m and error.angle_deg <= limits.within_deg
    return PaperRow(
        run=run.name, target=target.lidar, source=source.lidar, success=success, error=error, **_figures(error)
    )


def _placed_pose(run: SavedRun, placement: LidarPlacement) -> RigidTransform | None:
    if placement.lidar == run.target:
        return RigidTransform.identity(run.target, run.target)
    return None if placement.uncertain else placement.T_target_source
