# SPDX-License-Identifier: Apache-2.0
"""Comparison of runs with ground truth."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from multilica.errors import InputError, UsageError
from multilica.extrinsics import Extrinsics
from multilica.results import LidarPlacement
from multilica.results.document.values import Entry
from multilica.runs.pose_error import PoseError, as_sigma, normalised_error
from multilica.runs.run_documents import SavedRun

Outcome = Literal["within", "between", "false_accept", "false_refuse", "uncertain_within", "uncertain_beyond"]

UNCERTAIN_SIGMA = 3.0
"""An uncertain pose that is off by more of its own sigma (`as_sigma`) is `uncertain_beyond`."""


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Limits of a right and of a wrong placement.

    Args:
        within_m, within_rad: a placed LiDAR off by no more than both is a success.
        wrong_m, wrong_rad: a placed LiDAR off by more than either is a false accept.
        wrong_sigma: so is one that is off by more sigma of its own covariance (`as_sigma`).

    Raises:
        UsageError: a limit is not above zero, or `within` is above `wrong`.
    """

    within_m: float = 0.02
    within_rad: float = math.radians(0.1)
    wrong_m: float = 0.05
    wrong_rad: float = math.radians(0.5)
    wrong_sigma: float = 4.0

    def __post_init__(self) -> None:
        for unit, scale, within, wrong in (
            ("m", 1.0, self.within_m, self.wrong_m),
            ("deg", math.degrees(1.0), self.within_rad, self.wrong_rad),
        ):
            if not 0.0 < within <= wrong < math.inf:
                raise UsageError(
                    f"Found 'within' {within * scale:g} {unit} and 'wrong' {wrong * scale:g} {unit}; "
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
        if error.distance_m > self.wrong_m or error.angle_rad > self.wrong_rad:
            return "false_accept"
        if normalised is not None and as_sigma(normalised) > self.wrong_sigma:
            return "false_accept"
        right = error.distance_m <= self.within_m and error.angle_rad <= self.within_rad
        return "within" if right else "between"


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The true poses of the LiDARs in any common frame, with the name of their file."""

    name: str
    extrinsics: Extrinsics

    def __contains__(self, lidar: str) -> bool:
        return lidar in self.extrinsics.members


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """One LiDAR of one run compared with the truth.

    Args:
        error: None if the run has no pose of the LiDAR.
        normalised: the `normalised_error`; None also if the run has no covariance.
    """

    run: str
    truth: str
    target: str
    placement: LidarPlacement
    error: PoseError | None
    normalised: float | None
    outcome: Outcome

    @property
    def error_sigma(self) -> float | None:
        """The normalised error as the deviation of one normal variable, see `as_sigma`."""
        return None if self.normalised is None else as_sigma(self.normalised)


class LeftOut(Entry):
    """A LiDAR, or a whole run if `lidar` is None, that no count includes."""

    run: str
    lidar: str | None
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """Counts of outcomes, with statistics per component of the absolute errors of placed LiDARs; None without any."""

    within: int
    between: int
    false_accept: int
    false_refuse: int
    uncertain_within: int
    uncertain_beyond: int
    rmse: PoseError | None
    median: PoseError | None
    largest: PoseError | None

    @property
    def lidars(self) -> int:
        """Number of compared LiDARs."""
        return self.within + self.between + self.false_accept + self.false_refuse + self.uncertain

    @property
    def uncertain(self) -> int:
        """Number of compared LiDARs whose pose the run calls uncertain."""
        return self.uncertain_within + self.uncertain_beyond


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """All runs compared with the truth, in the given order, per LiDAR in name order; targets are not compared."""

    tolerances: Tolerances
    runs: tuple[str, ...]
    comparisons: tuple[Comparison, ...]
    left_out: tuple[LeftOut, ...]

    @property
    def overall(self) -> Summary:
        """Summary over all LiDARs and runs."""
        return summarise(self.comparisons)

    @property
    def by_lidar(self) -> dict[str, Summary]:
        """Summary over all runs, per LiDAR in name order."""
        names = sorted({comparison.placement.lidar for comparison in self.comparisons})
        return {name: summarise([one for one in self.comparisons if one.placement.lidar == name]) for name in names}

    @property
    def compared_runs(self) -> tuple[str, ...]:
        """Runs with at least one compared LiDAR."""
        return tuple(dict.fromkeys(comparison.run for comparison in self.comparisons))

    @property
    def faultless_runs(self) -> tuple[str, ...]:
        """Runs of which every compared LiDAR is within the limits."""
        faulty = {comparison.run for comparison in self.comparisons if comparison.outcome != "within"}
        return tuple(run for run in self.compared_runs if run not in faulty)


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
    comparisons: list[Comparison] = []
    left_out: list[LeftOut] = []
    for run, truth in zip(runs, truth_per_run(truths, len(runs)), strict=True):
        left_out += _left_out(run, truth)
        found = [
            one
            for one in run.placements
            if one.lidar != run.target and {one.lidar, run.target} <= truth.extrinsics.members
        ]
        comparisons += [_comparison(run, truth, one, tolerances) for one in found]
    if not comparisons:
        why = f": {left_out[0].reason}" if left_out else ""
        raise InputError(f"No LiDAR of {', '.join(names) or 'no run'} can be compared with the truth{why}.")
    return Evaluation(tolerances, tuple(names), tuple(comparisons), tuple(left_out))


def summarise(comparisons: Sequence[Comparison]) -> Summary:
    """Return counts and statistics of comparisons."""
    counts = Counter(one.outcome for one in comparisons)
    errors = [one.error for one in comparisons if one.error is not None and not one.placement.uncertain]
    return Summary(
        within=counts["within"],
        between=counts["between"],
        false_accept=counts["false_accept"],
        false_refuse=counts["false_refuse"],
        uncertain_within=counts["uncertain_within"],
        uncertain_beyond=counts["uncertain_beyond"],
        rmse=PoseError.statistic(errors, lambda rows: np.sqrt(np.mean(rows**2, axis=0))),
        median=PoseError.statistic(errors, lambda rows: np.median(rows, axis=0)),
        largest=PoseError.statistic(errors, lambda rows: np.max(rows, axis=0)),
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


def _comparison(run: SavedRun, truth: Truth, placement: LidarPlacement, tolerances: Tolerances) -> Comparison:
    error, normalised = None, None
    if placement.T_target_source is not None:
        true_pose = truth.extrinsics.between(run.target, placement.lidar)
        error = PoseError.between(placement.T_target_source, true_pose)
        if placement.covariance is not None:
            normalised = normalised_error(placement.T_target_source, true_pose, placement.covariance)
    outcome = tolerances.outcome(error, normalised, uncertain=placement.uncertain)
    return Comparison(run.name, truth.name, run.target, placement, error, normalised, outcome)
