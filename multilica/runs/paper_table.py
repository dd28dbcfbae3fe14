# SPDX-License-Identifier: Apache-2.0
"""The evaluation of the paper: errors per axis over scenes and LiDARs.

Definitions of Kulmer et al. 2024, section "Evaluation Metrics"; where its text leaves a choice, those of the evaluation
scripts that the authors publish with their code.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Self

import numpy as np

from multilica.geometry import FloatArray, RigidTransform, read_only, rotation_angle_rad
from multilica.results import LidarPlacement
from multilica.runs.evaluation import Evaluation, Tolerances, Truth, evaluate, truth_per_run
from multilica.runs.run_documents import SavedRun


@dataclass(frozen=True, slots=True, eq=False)
class AxisError:
    """The error of ``T_target_source`` as the paper computes it, or the root mean square of many.

    Args:
        translation_m: (3,) found - true, along the target's axes.
        rotation_rad: (3,) roll, pitch, yaw (extrinsic xyz) of ``inverse(true) @ found``, about the source's axes.
        angle_rad: angle of that rotation.
    """

    translation_m: FloatArray
    rotation_rad: FloatArray
    angle_rad: float

    @classmethod
    def between(cls, found: RigidTransform, true: RigidTransform) -> Self:
        """Compute the error of a found pose."""
        turn = true.rotation.T @ found.rotation
        rpy_rad = RigidTransform.from_rotation_translation("", "", turn, np.zeros(3)).rpy_rad
        shift_m = read_only(found.xyz_m - true.xyz_m, np.float64)
        return cls(shift_m, read_only(rpy_rad, np.float64), rotation_angle_rad(turn))

    @classmethod
    def root_mean_square(cls, errors: Sequence[Self]) -> Self | None:
        """Compute the root mean square per component; None without errors."""
        if not errors:
            return None
        rows = np.array([[*one.translation_m, *one.rotation_rad, one.angle_rad] for one in errors])
        values = read_only(np.sqrt(np.mean(rows**2, axis=0)), np.float64)
        return cls(values[:3], values[3:6], float(values[6]))

    def within(self, limits: Tolerances) -> bool:
        """Return whether distance and angle are within the limits of a success."""
        distance_m = float(np.linalg.norm(self.translation_m))
        return distance_m <= limits.within_m and self.angle_rad <= limits.within_rad


@dataclass(frozen=True, slots=True, eq=False)
class PairError:
    """The pose of one LiDAR relative to another in one run.

    Args:
        error: None unless the run places both.
        success: both are placed, and the error is within the limits.
    """

    run: str
    target: str
    source: str
    error: AxisError | None
    success: bool


@dataclass(frozen=True, slots=True, eq=False)
class PaperSummary:
    """Errors over scenes and LiDARs; `rmse` covers the placed ones, wrong ones included, None without any."""

    poses: int
    placed: int
    successes: int
    rmse: AxisError | None

    @property
    def placed_rate(self) -> float:
        """Share of the poses that the runs give; nan without poses."""
        return self.placed / self.poses if self.poses else math.nan

    @property
    def success_rate(self) -> float:
        """Share of the poses that are right; nan without poses."""
        return self.successes / self.poses if self.poses else math.nan


@dataclass(frozen=True, slots=True, eq=False)
class PaperTable:
    """The paper's table of a set of runs.

    Args:
        evaluation: the comparison of the same runs with the same truths, with its limits and what it left out.
        to_target: every compared LiDAR of every run, relative to the run's target.
        between: every two compared LiDARs of every run, names in order, the target among them.
    """

    evaluation: Evaluation
    to_target: tuple[PairError, ...]
    between: tuple[PairError, ...]

    @property
    def overall(self) -> PaperSummary:
        """Figures over all scenes and LiDARs, relative to the target: those that the paper shows."""
        return summarise_pairs(self.to_target)

    @property
    def overall_between(self) -> PaperSummary:
        """Figures over all scenes and pairs of LiDARs."""
        return summarise_pairs(self.between)

    @property
    def by_lidar(self) -> dict[str, PaperSummary]:
        """Figures over all scenes, per LiDAR in name order."""
        names = sorted({one.source for one in self.to_target})
        return {name: summarise_pairs(one for one in self.to_target if one.source == name) for name in names}

    @property
    def by_pair(self) -> dict[tuple[str, str], PaperSummary]:
        """Figures over all scenes, per pair (target, source) in name order."""
        pairs = sorted({(one.target, one.source) for one in self.between})
        return {
            pair: summarise_pairs(one for one in self.between if (one.target, one.source) == pair) for pair in pairs
        }


def paper_table(runs: Sequence[SavedRun], truths: Sequence[Truth], tolerances: Tolerances | None = None) -> PaperTable:
    """Compute the paper's table of runs, with one truth for all or one each in the same order.

    Raises:
        UsageError: wrong number of truths, or a run given twice.
        InputError: no LiDAR of any run could be compared.
    """
    evaluation = evaluate(runs, truths, tolerances)
    to_target: list[PairError] = []
    between: list[PairError] = []
    for run, truth in zip(runs, truth_per_run(truths, len(runs)), strict=True):
        if run.target not in truth:
            continue
        known = sorted((one for one in run.placements if one.lidar in truth), key=lambda one: one.lidar)
        target = next((one for one in known if one.lidar == run.target), LidarPlacement(run.target, ""))
        pairs = [(target, one) for one in known if one.lidar != run.target]
        to_target += [_pair_error(run, truth, *pair, evaluation.tolerances) for pair in pairs]
        between += [_pair_error(run, truth, *pair, evaluation.tolerances) for pair in combinations(known, 2)]
    return PaperTable(evaluation, tuple(to_target), tuple(between))


def summarise_pairs(pairs: Iterable[PairError]) -> PaperSummary:
    """Return counts and root mean squares of errors."""
    pairs = list(pairs)
    errors = [one.error for one in pairs if one.error is not None]
    return PaperSummary(len(pairs), len(errors), sum(one.success for one in pairs), AxisError.root_mean_square(errors))


def _pair_error(
    run: SavedRun, truth: Truth, target: LidarPlacement, source: LidarPlacement, limits: Tolerances
) -> PairError:
    poses = [_placed_pose(run, one) for one in (target, source)]
    if poses[0] is None or poses[1] is None:
        return PairError(run.name, target.lidar, source.lidar, None, success=False)
    found = poses[0].inverse() @ poses[1]
    error = AxisError.between(found, truth.extrinsics.between(target.lidar, source.lidar))
    return PairError(run.name, target.lidar, source.lidar, error, success=error.within(limits))


def _placed_pose(run: SavedRun, placement: LidarPlacement) -> RigidTransform | None:
    if placement.lidar == run.target:
        return RigidTransform.identity(run.target, run.target)
    return None if placement.uncertain else placement.T_target_source
