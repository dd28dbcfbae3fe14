# SPDX-License-Identifier: Apache-2.0
"""Significant changes of one series of poses, between and in periods in which the pose rests or creeps.

The partition with the least penalised cost is found by dynamic programming (Jackson et al., IEEE Signal Process. Lett.
12, 2005). The cost of a period is the weighted sum of squares about its mean or its line in time, so that for two
periods the search is the generalised likelihood ratio test over all splits (Basseville & Nikiforov, Detection of Abrupt
Changes, 1993). The penalties are the thresholds of the tests at the false-alarm rate, corrected for their number.

`ruptures` has the same search, but its `BaseCost.fit` takes a signal without covariances: each log here has its own, of
all six components. A custom cost would have to compute all of this file but the ten lines of `_partition`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtrc, fdtri

from multilica.fleet.drift.dispersion import ScatteredPoses
from multilica.fleet.drift.findings import ChangeKind
from multilica.fleet.lidar_series import TO_LENGTHS, LidarSeries
from multilica.geometry import FloatArray

_MIN_LOGS = 2
"""Least logs of a period: a jump needs a second log that confirms it, or one bad pose would be two jumps."""
_MIN_CREEP_LOGS = 4
_SPLIT_TESTS, _CREEP_TESTS = 4.0 / 3.0, 4.0
# More boundaries are not tried at first; each one found is then placed among all logs.
_MAX_BOUNDARIES = 200
_NEWEST_LOGS = 16
_RIDGE = 1e-12


@dataclass(frozen=True, slots=True)
class Period:
    """Logs from `start` up to, and without, `end`."""

    start: int
    end: int
    creeps: bool = False


@dataclass(frozen=True, slots=True)
class Thresholds:
    """Least reduction of the sum of squares that a jump and a creep must bring, in a series of N logs.

    Three quarters of the false alarms are left to the best of all splits, a quarter to the creep (Bonferroni): with
    equal parts, the creep would have so much the lower threshold that it would be named for jumps of short series.
    """

    false_alarm_rate: float
    logs: int
    dof: float

    def least(self, *, creep: bool) -> float:
        """Return the limit for a creep, or for a jump at the best split."""
        return 6.0 * float(fdtri(6, self.dof, 1.0 - self.false_alarm_rate / self._tests(creep=creep)))

    def p_value(self, squared: float, *, creep: bool) -> float:
        """Return the share of series without any change in which the best jump, or the creep, is as large."""
        return min(1.0, self._tests(creep=creep) * float(fdtrc(6, self.dof, squared / 6.0)))

    def _tests(self, *, creep: bool) -> float:
        return _CREEP_TESTS if creep else _SPLIT_TESTS * max(1, self.logs - 2 * _MIN_LOGS + 1)


class PeriodFits:
    """Weighted fits of constants and lines to any period of a series.

    Args:
        poses: whose order is that of time.
    """

    def __init__(self, poses: ScatteredPoses) -> None:
        time_ns = poses.series.time_ns
        self.count = len(time_ns)
        self.shared = poses.shared
        since = (time_ns - time_ns[0]).astype(np.float64) if self.count else np.zeros(0)
        self.span_ns = max(float(since[-1]) if self.count else 0.0, 1.0)
        self.time = 2.0 * since / self.span_ns - 1.0
        weights = np.linalg.inv(poses.covariances)
        weighted = np.einsum("nij,nj->ni", weights, poses.offsets_m)
        t = self.time
        self._w, self._wt, self._wtt = (_sums(weights * factor[:, None, None]) for factor in (t**0, t, t**2))
        self._y, self._yt = (_sums(weighted * factor[:, None]) for factor in (t**0, t))
        self._yy = _sums(np.einsum("ni,ni->n", weighted, poses.offsets_m))

    def costs(self, starts: np.ndarray, end: int) -> tuple[FloatArray, FloatArray]:
        """Return the sums of squares about the mean and about the line of the periods from each start to one end."""
        total = self._yy[end] - self._yy[starts]
        right = self._y[end] - self._y[starts]
        mean = np.linalg.solve(self._w[end] - self._w[starts], right[..., None])[..., 0]
        flat = total - np.einsum("ni,ni->n", mean, right)
        sloped = np.full(len(starts), np.inf)
        able = (end - starts >= _MIN_CREEP_LOGS) & (self.time[end - 1] > self.time[starts])
        if able.any():
            matrix, both = self._line(starts[able], end)
            line = np.linalg.solve(matrix, both[..., None])[..., 0]
            sloped[able] = total[able] - np.einsum("ni,ni->n", line, both)
        return flat, sloped

    def value(self, period: Period, time: float) -> tuple[FloatArray, FloatArray]:
        """Return the pose (6,) that a period has at a time (-1 to 1 over the series), and its covariance (6, 6)."""
        if not period.creeps:
            covariance = np.linalg.inv(self._w[period.end] - self._w[period.start])
            return covariance @ (self._y[period.end] - self._y[period.start]), covariance
        line, covariance = self.line(period)
        at = np.hstack([np.eye(6), time * np.eye(6)])
        return at @ line, at @ covariance @ at.T

    def line(self, period: Period) -> tuple[FloatArray, FloatArray]:
        """Return the line (12,) through a period, its value at time 0 and its slope, and its covariance (12, 12)."""
        matrix, both = self._line(np.array([period.start]), period.end)
        covariance = np.linalg.inv(matrix[0])
        return covariance @ both[0], covariance

    def motion(self, period: Period) -> tuple[FloatArray, FloatArray]:
        """Return how far (6,) the line through a period moves from its first to its last log, and its covariance.

        That has the errors that logs share, as of two halves: a line through a step in the middle rises by 1.5 times
        the step.
        """
        line, covariance = self.line(period)
        span = self.time[period.end - 1] - self.time[period.start]
        return span * line[6:], span**2 * covariance[6:, 6:] + 1.5**2 * 2.0 * self.shared

    def jump(self, before: Period, after: Period) -> tuple[FloatArray, FloatArray]:
        """Return the difference (6,) between two neighbouring periods half way between them, and its covariance.

        That has the errors that the logs on each of the two sides share.
        """
        between = (self.time[after.start - 1] + self.time[after.start]) / 2.0
        (old, old_covariance), (new, new_covariance) = self.value(before, between), self.value(after, between)
        return new - old, old_covariance + new_covariance + 2.0 * self.shared

    def _line(self, starts: np.ndarray, end: int) -> tuple[FloatArray, FloatArray]:
        w, wt, wtt = (sums[end] - sums[starts] for sums in (self._w, self._wt, self._wtt))
        ridge = _RIDGE * np.trace(w, axis1=1, axis2=2)[:, None, None] * np.eye(6)
        matrix = np.block([[w, wt], [wt, wtt + ridge]])
        return matrix, np.hstack([self._y[end] - self._y[starts], self._yt[end] - self._yt[starts]])


def _partition(fits: PeriodFits, thresholds: Thresholds) -> list[Period]:
    """Partition a series into the periods of least cost; a single one that rests if nothing significant happens."""
    if fits.count < 2 * _MIN_LOGS:
        return [Period(0, fits.count)]
    spread = np.linspace(0, fits.count, min(fits.count, _MAX_BOUNDARIES) + 1).round().astype(int)
    # A jump that has just been confirmed may not wait until it falls on a boundary.
    boundaries = np.union1d(spread, np.arange(max(0, fits.count - _NEWEST_LOGS), fits.count))
    periods = _least_cost(fits, thresholds, boundaries)
    # A period of two logs about a jump between boundaries is none: all logs next to those found are tried together.
    near = [np.arange(each.start - _reach(fits), each.start + _reach(fits) + 1) for each in periods[1:]]
    tried = np.unique(np.concatenate([[0, fits.count], *near]).clip(0, fits.count))
    return _least_cost(fits, thresholds, tried) if near else periods


def _least_cost(fits: PeriodFits, thresholds: Thresholds, boundaries: np.ndarray) -> list[Period]:
    """Partition a series at some of the boundaries, the first and the last log among them."""
    jump, creep = thresholds.least(creep=False), thresholds.least(creep=True)
    best = [-jump, *[np.inf] * (len(boundaries) - 1)]
    last: list[tuple[int, bool]] = [(0, False)] * len(boundaries)
    for index, end in enumerate(boundaries):
        able = np.flatnonzero((boundaries <= end - _MIN_LOGS) & np.isfinite(best))
        if not len(able):
            continue
        flat, sloped = fits.costs(boundaries[able], int(end))
        options = np.array(best)[able] + np.minimum(flat, sloped + creep) + jump
        chosen = int(np.argmin(options))
        best[index] = float(options[chosen])
        last[index] = int(able[chosen]), bool(sloped[chosen] + creep < flat[chosen])
    periods: list[Period] = []
    index = len(boundaries) - 1
    while index:
        start, creeps = last[index]
        periods.insert(0, Period(int(boundaries[start]), int(boundaries[index]), creeps))
        index = start
    return periods


def _reach(fits: PeriodFits) -> int:
    """Return how many logs a change may be from its boundary at first."""
    return 2 * -(-fits.count // _MAX_BOUNDARIES)


def _place(fits: PeriodFits, periods: list[Period]) -> list[Period]:
    """Return the periods with each boundary at its best place among the logs next to it."""
    placed = list(periods)
    reach = _reach(fits)
    for index in range(len(placed) - 1):
        before, after = placed[index : index + 2]
        first = max(before.start + _MIN_LOGS, after.start - reach)
        options = range(first, min(after.end - _MIN_LOGS, after.start + reach) + 1)
        costs = [_cost(fits, before, before.start, at) + _cost(fits, after, at, after.end) for at in options]
        at = options[int(np.argmin(costs))]
        placed[index : index + 2] = [Period(before.start, at, before.creeps), Period(at, after.end, after.creeps)]
    return placed


def _cost(fits: PeriodFits, period: Period, start: int, end: int) -> float:
    flat, sloped = fits.costs(np.array([start]), end)
    return float((sloped if period.creeps else flat)[0])


def _sums(values: FloatArray) -> FloatArray:
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(values, axis=0)])


@dataclass(frozen=True, slots=True, eq=False)
class PoseChange:
    """One significant change.

    Args:
        before: index of the last log before a jump, or of the first log of a creep.
        index: of the first log after a jump, or of the first log that a creep has moved by more than its own sigma.
        end: index of the last log of a creep; `index` for a jump.
        offset: (6,) rotation (rad), translation (m) along the target's axes, of a creep from its first to its last log.
        squared: the test's chi squared.
    """

    series: LidarSeries
    kind: ChangeKind
    before: int
    index: int
    end: int
    offset: FloatArray
    squared: float
    p_value: float

    @property
    def start_ns(self) -> int:
        """Time of the log `before`."""
        return int(self.series.time_ns[self.before])

    @property
    def end_ns(self) -> int:
        """Time of the log `end`."""
        return int(self.series.time_ns[self.end])


@dataclass(frozen=True, slots=True, eq=False)
class SeriesChanges:
    """A series in periods of rest and creep, with the changes between and in them."""

    poses: ScatteredPoses
    fits: PeriodFits
    periods: tuple[Period, ...]
    changes: tuple[PoseChange, ...]

    def step_at(self, time_ns: int) -> tuple[FloatArray, FloatArray] | None:
        """Return the offset (6,) from before to after a time, significant or not, and its covariance (6, 6).

        None where no log is on one of the sides. A boundary next to that time is taken for it.
        """
        at = int(np.searchsorted(self.poses.series.time_ns, time_ns))
        near = [index for index in range(1, len(self.periods)) if abs(self.periods[index].start - at) <= 1]
        if near:
            before, after = self.periods[near[0] - 1], self.periods[near[0]]
        else:
            whole = next((each for each in self.periods if each.start < at < each.end), None)
            if whole is None:
                return None
            before, after = Period(whole.start, at), Period(at, whole.end)
        return _unscaled(*self.fits.jump(before, after))

    def motion_between(self, start_ns: int, end_ns: int) -> tuple[FloatArray, FloatArray] | None:
        """Return the offset (6,) of a uniform motion from one time to another, and its covariance (6, 6).

        From the longest part of a period between the two; None if no part of it has three logs.
        """
        time_ns = self.poses.series.time_ns
        first, last = np.searchsorted(time_ns, start_ns), np.searchsorted(time_ns, end_ns, side="right")
        parts = [Period(max(each.start, int(first)), min(each.end, int(last)), creeps=True) for each in self.periods]
        longest = max(parts, key=lambda part: part.end - part.start)
        if longest.end - longest.start < 3 or time_ns[longest.end - 1] == time_ns[longest.start]:
            return None
        motion, covariance = self.fits.motion(longest)
        longer = (end_ns - start_ns) / float(time_ns[longest.end - 1] - time_ns[longest.start])
        return _unscaled(longer * motion, longer**2 * covariance)


def find_changes(poses: ScatteredPoses, false_alarm_rate: float) -> SeriesChanges:
    """Find the changes of a series that are significant beside the errors that all logs of a period share.

    Args:
        false_alarm_rate: share of series without any change in which one is found.
    """
    fits = PeriodFits(poses)
    thresholds = Thresholds(false_alarm_rate, fits.count, poses.dof)
    periods = _partition(fits, thresholds)
    while True:
        tested = list(_tested(poses, fits, periods, thresholds))
        # Changes that explain nothing; where a creep begins, the pose does not jump, so that boundary stays.
        weak = [
            (change.p_value, -change.squared, index, change.kind)
            for index, change in tested
            if change.p_value > false_alarm_rate
            and (change.kind == "creep" or not (periods[index - 1].creeps or periods[index].creeps))
        ]
        if not weak:
            break
        periods = _place(fits, _without(fits, periods, *max(weak)[2:], thresholds))
    significant = tuple(change for _, change in tested if change.p_value <= false_alarm_rate)
    return SeriesChanges(poses, fits, tuple(periods), significant)


def _without(
    fits: PeriodFits, periods: list[Period], index: int, kind: ChangeKind, thresholds: Thresholds
) -> list[Period]:
    if kind == "creep":
        return [*periods[:index], replace(periods[index], creeps=False), *periods[index + 1 :]]
    start, end = periods[index - 1].start, periods[index].end
    flat, sloped = fits.costs(np.array([start]), end)
    joined = Period(start, end, creeps=bool(sloped[0] + thresholds.least(creep=True) < flat[0]))
    return [*periods[: index - 1], joined, *periods[index + 1 :]]


def _tested(
    poses: ScatteredPoses, fits: PeriodFits, periods: list[Period], thresholds: Thresholds
) -> Iterator[tuple[int, PoseChange]]:
    """Yield the jump before each period and the creep in it, with the period's index, significant or not."""

    def change(kind: ChangeKind, logs: tuple[int, int, int], offset_m: FloatArray, squared: float) -> PoseChange:
        p_value = thresholds.p_value(squared, creep=kind == "creep")
        return PoseChange(poses.series, kind, *logs, offset_m / TO_LENGTHS, squared, p_value)

    for index, period in enumerate(periods):
        start, last = period.start, period.end - 1
        if index:
            offset_m, covariance = fits.jump(periods[index - 1], period)
            yield index, change("jump", (start - 1, start, start), offset_m, _squared(offset_m, covariance))
        if period.creeps:
            motion_m, _ = fits.motion(period)
            # One log far from the others in time would make a creep of its own error.
            parts = [period, Period(start + 1, period.end), Period(start, last)]
            squared = min(_squared(*fits.motion(part)) for part in parts)
            yield index, change("creep", (start, _first_visible(poses, period, motion_m), last), motion_m, squared)


def _first_visible(poses: ScatteredPoses, period: Period, motion_m: FloatArray) -> int:
    """Return the first log until which a creep has moved by more than one sigma of that log's pose (six directions)."""
    logs = np.arange(period.start, period.end)
    since = (poses.series.time_ns[logs] - poses.series.time_ns[period.start]).astype(np.float64)
    moved = (since / since[-1])[:, None] * motion_m
    squared = np.einsum("ni,ni->n", moved, np.linalg.solve(poses.covariances[logs], moved[..., None])[..., 0])
    visible = np.flatnonzero(squared > 6.0)
    return int(logs[visible[0]] if len(visible) else logs[-1])


def _squared(offset_m: FloatArray, covariance: FloatArray) -> float:
    return float(offset_m @ np.linalg.solve(covariance, offset_m))


def _unscaled(offset_m: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return an offset in radians and metres, and its covariance."""
    return offset_m / TO_LENGTHS, covariance / np.outer(TO_LENGTHS, TO_LENGTHS)
