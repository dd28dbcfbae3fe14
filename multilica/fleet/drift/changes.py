# SPDX-License-Identifier: Apache-2.0
"""Significant changes of one series of poses."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from multilica.fleet.drift.dispersion import SHARED_COVARIANCE, ScatteredPoses
from multilica.fleet.drift.findings import ChangeKind
from multilica.fleet.drift.segments import Period, PeriodFits, Thresholds, partition, place
from multilica.fleet.lidar_series import TO_LENGTHS, LidarSeries
from multilica.geometry import FloatArray


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
    periods = partition(fits, thresholds)
    while (weakest := _weakest(poses, fits, periods, thresholds)) is not None:
        periods = place(fits, _without(fits, periods, weakest, thresholds))
    changes = [
        change
        for _, change in _tested(poses, fits, periods, thresholds)
        if change.p_value <= thresholds.false_alarm_rate
    ]
    return SeriesChanges(poses, fits, tuple(periods), tuple(changes))


def _weakest(
    poses: ScatteredPoses, fits: PeriodFits, periods: list[Period], thresholds: Thresholds
) -> tuple[int, ChangeKind] | None:
    """Return the period of the least significant change that explains nothing, with the kind of the change.

    A boundary of a creeping period stays: where a creep begins, the pose does not jump.
    """
    weak = [
        (change.p_value, -change.squared, index, change.kind)
        for index, change in _tested(poses, fits, periods, thresholds)
        if change.p_value > thresholds.false_alarm_rate
        and (change.kind == "creep" or not (periods[index - 1].creeps or periods[index].creeps))
    ]
    return max(weak)[2:] if weak else None


def _without(
    fits: PeriodFits, periods: list[Period], weakest: tuple[int, ChangeKind], thresholds: Thresholds
) -> list[Period]:
    index, kind = weakest
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
    """Return chi squared of an offset, with the errors that the logs on each of the two sides share."""
    return float(offset_m @ np.linalg.solve(covariance + 2.0 * SHARED_COVARIANCE, offset_m))


def _unscaled(offset_m: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return an offset in radians and metres, and its covariance with the shared errors of two sides."""
    return offset_m / TO_LENGTHS, (covariance + 2.0 * SHARED_COVARIANCE) / np.outer(TO_LENGTHS, TO_LENGTHS)
