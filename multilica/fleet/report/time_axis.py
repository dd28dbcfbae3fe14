# SPDX-License-Identifier: Apache-2.0
"""Axis of time with ticks at calendar days, months or years."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import numpy as np
import numpy.typing as npt

from multilica.geometry import FloatArray

_NS_PER_DAY = 86_400 * 10**9
_MONTHS = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")
_MOST_TICKS = 7
_STEPS_DAYS = (1, 2, 5, 10)
_STEPS_MONTHS = (1, 2, 3, 6, 12, 24, 60, 120, 240)
_PADDING = 0.03
_LEAST_DAYS = 3.0


def day_of(time_ns: int) -> str:
    """Return the day of a time in UTC, as 2026-03-01."""
    return f"{_moment(time_ns):%Y-%m-%d}"


@dataclass(frozen=True, slots=True)
class TimeAxis:
    """A range of times over a range of pixels."""

    begin_ns: int
    end_ns: int
    left_px: float
    right_px: float

    @classmethod
    def around(cls, times_ns: npt.NDArray[np.int64], left_px: float, right_px: float) -> TimeAxis:
        """Create an axis that shows all times (N,), N > 0, of at least three days."""
        first, last = int(times_ns.min()), int(times_ns.max())
        margin = int(max(_PADDING * (last - first), (_LEAST_DAYS * _NS_PER_DAY - (last - first)) / 2.0))
        return cls(first - margin, last + margin, left_px, right_px)

    def place(self, times_ns: npt.ArrayLike) -> FloatArray:
        """Return the pixels of times."""
        share = (np.asarray(times_ns, dtype=np.float64) - self.begin_ns) / (self.end_ns - self.begin_ns)
        return np.asarray(self.left_px + share * (self.right_px - self.left_px))

    def ticks(self) -> list[tuple[float, str]]:
        """Return pixels and labels of at most eight ticks; the first one and January name the year."""
        days = (self.end_ns - self.begin_ns) / _NS_PER_DAY
        step = next((step for step in _STEPS_DAYS if days / step <= _MOST_TICKS), None)
        moments = list(self._months(days) if step is None else self._days(step))
        return [
            (
                float(self.place(int(moment.timestamp()) * 10**9)),
                _label(moment, named=step is not None, first=not index),
            )
            for index, moment in enumerate(moments)
        ]

    def _days(self, step: int) -> Iterator[datetime]:
        moment = _moment(self.begin_ns).replace(hour=0, minute=0, second=0, microsecond=0) + timedelta(days=1)
        while moment <= _moment(self.end_ns):
            yield moment
            moment += timedelta(days=step)

    def _months(self, days: float) -> Iterator[datetime]:
        fitting = (step for step in _STEPS_MONTHS if days / (30.44 * step) <= _MOST_TICKS)
        step = next(fitting, _STEPS_MONTHS[-1])
        begin, end = _moment(self.begin_ns), _moment(self.end_ns)
        count = 12 * begin.year + begin.month  # the month after `begin`, counted from 0
        for months in range(-(-count // step) * step, 12 * end.year + end.month, step):
            yield datetime(months // 12, months % 12 + 1, 1, tzinfo=UTC)


def _label(moment: datetime, *, named: bool, first: bool) -> str:
    if named:
        return f"{moment.day} {_MONTHS[moment.month - 1]}{f' {moment.year}' if first else ''}"
    if moment.month == 1:
        return str(moment.year)
    return f"{_MONTHS[moment.month - 1]}{f' {moment.year}' if first else ''}"


def _moment(time_ns: int) -> datetime:
    return datetime.fromtimestamp(time_ns // 10**9, UTC)
